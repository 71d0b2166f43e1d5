"""Many surveys drawn from one description: streets of several kinds, each seen by a scanner of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.parameters.presets import PRESETS
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

_KEYS = ("count", "presets", "streets", "variety", "factors", "seed")
_FACTORS = ("trees", "shrubs", "clutter", "signs", "people", "traffic", "two_wheelers", "lorries")
_SHARES = ("parking", "parked", "verges", "boundaries", "greenery", "hard_cases", "bare_soil", "drive_cars")
_NARROW, _CUT = (
    0.25,
    0.25,
)  # shares, at a variety of 1, of heads that see a sector only and of those without upper beams


def expanded_surveys(surveys: Mapping[str, Mapping[str, Any] | None]) -> dict[str, Mapping[str, Any] | None]:
    """Replace each description with a ``count`` by that many surveys, named ``NAME_000`` and so on."""
    out: dict[str, Mapping[str, Any] | None] = {}
    for name, config in surveys.items():
        several = config is not None and "count" in config
        drawn = _drawn(name, config) if several and config is not None else {name: config}
        twice = sorted(set(drawn) & set(out))
        if twice:
            raise ParameterError(f"two simulated surveys are named {twice[0]!r}")
        out |= drawn
    return out


def _drawn(name: str, config: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    count, variety, seed = config["count"], config.get("variety", 0.5), config.get("seed", 0)
    presets, streets = list(config.get("presets", ())), list(config.get("streets", STREETS))
    whole = [(count, "count", 1), (seed, "seed", 0)]
    for value, key, least in whole:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ParameterError(f"{name}: {key} must be an integer >= {least}, got {value!r}")
    if isinstance(variety, bool) or not isinstance(variety, int | float) or not 0 <= variety <= 1:
        raise ParameterError(f"{name}: variety must be between 0 and 1, got {variety!r}")
    for names, known, key in ((presets, PRESETS, "presets"), (streets, STREETS, "streets")):
        wrong = [str(n) for n in names if n not in known]
        if not names or wrong:
            raise ParameterError(f"{name}: {key} must be some of {', '.join(known)}, got {', '.join(wrong) or 'none'}")
    factors = config.get("factors", {})
    unknown = [str(key) for key in factors if key not in _FACTORS]
    if unknown:
        raise ParameterError(f"{name}: factors must name some of {', '.join(_FACTORS)}, got {unknown[0]}")
    common = {key: value for key, value in config.items() if key not in _KEYS}
    surveys: dict[str, Mapping[str, Any]] = {}
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        preset, kind = presets[k % len(presets)], streets[(k % len(presets) + k // len(presets)) % len(streets)]
        one = {"preset": preset, "seed": int(rng.integers(2**31)), **common}
        surveys[f"{name}_{k:03d}"] = {
            **one,
            "street": _street(kind, float(variety), factors, rng),
            "varied": _varied(preset, float(variety), rng),
        }
    return surveys


def _street(kind: str, variety: float, factors: Mapping[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """Return a kind of street with other numbers of objects, bends and slopes."""
    base = STREETS[kind]
    street: dict[str, Any] = {"kind": kind}
    for name in _FACTORS:
        value = getattr(base, name) * factors.get(name, 1.0) * np.exp(0.6 * variety * rng.normal())
        street[name] = round(float(min(value, 5.0)), 2)
    for name in _SHARES:
        value = getattr(base, name) + 0.25 * variety * rng.normal() * (getattr(base, name) > 0)
        street[name] = round(float(np.clip(value, 0.0, 1.0)), 2)
    street["bends"] = round(float(np.clip(1.0 + variety * rng.uniform(-1.0, 0.5), 0.0, 1.5)), 2)
    street["slopes"] = round(float(np.clip(np.exp(0.6 * variety * rng.normal()), 0.0, 2.0)), 2)
    return street


def _varied(preset: str, variety: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return the variation of a preset's scanner."""
    device = PRESETS[preset].scanner.devices[0]
    varied: dict[str, Any] = {
        "height": rng.uniform(-0.35, 0.45) * variety,
        "pitch": np.clip(1.5 * rng.normal(), -4, 4) * variety, "roll": np.clip(rng.normal(), -3, 3) * variety,
        "rate": 1.0 - variety * rng.uniform(-0.15, 0.5), "noise": np.exp(0.7 * variety * rng.normal()),
        "sensitivity": 3.0 * variety * rng.normal(), "dropout": 0.2 * variety * rng.random() ** 3,
    }  # fmt: skip
    varied = {key: round(float(value), 3) for key, value in varied.items()}
    upright = len(device.elevations) > 1
    sector, cut, scaled = rng.random(3)
    half, top, dark = rng.uniform(30.0, 120.0), rng.uniform(1.0, 6.0), rng.normal(5.0, 3.0)
    if upright and sector < _NARROW * variety and device.field == (-180.0, 180.0):
        varied["field"] = (round(-float(half), 1), round(float(half), 1))
    if upright and cut < _CUT * variety and max(device.elevations) > top:
        varied["top"] = round(float(top), 1)
    if scaled < 0.5 * variety:
        varied["intensity"] = (round(float(dark), 1), round(float(dark + rng.uniform(20.0, 36.0)), 1))
    return varied
