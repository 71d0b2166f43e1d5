"""Errors of the measures of an inventory against the truth of a simulated survey."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError

UNITS = {
    "base": "m", "elevation": "m", "height": "m", "tilt": "deg", "lean_azimuth": "deg", "panel_bottom": "m",
    "panel_centre": "m", "panel_height": "m", "panel_width": "m", "facing": "deg", "heading": "deg", "length": "m",
    "width": "m",
}  # fmt: skip
"""Compared measures and their units."""

LEAST_LEAN = 1.0
"""Minimum true tilt for comparing the direction of lean, degrees."""


def place_of(truth: pd.DataFrame) -> np.ndarray:
    """Return the positions of true objects."""
    vehicle = (truth["kind"] == "vehicle").to_numpy()[:, None]
    return np.where(vehicle, truth[["box_x", "box_y"]].to_numpy(), truth[["x", "y"]].to_numpy())


def match_to_truth(objects: pd.DataFrame, truth: pd.DataFrame, *, reach: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Match objects and true objects of the same kind, nearest pairs first, each at most once."""
    where, expected = objects[["x", "y"]].to_numpy(), place_of(truth)
    pairs = []
    for kind in sorted(set(objects["kind"]) & set(truth["kind"])):
        a, b = np.flatnonzero(objects["kind"] == kind), np.flatnonzero(truth["kind"] == kind)
        near = cKDTree(where[a]).sparse_distance_matrix(cKDTree(expected[b]), reach, output_type="coo_matrix")
        pairs += list(zip(near.data, a[near.row], b[near.col], strict=True))
    matched_a: set[int] = set()
    matched_b: set[int] = set()
    chosen = []
    for _, a, b in sorted(pairs):
        if a not in matched_a and b not in matched_b:
            matched_a.add(a)
            matched_b.add(b)
            chosen.append((a, b))
    rows = np.array(sorted(chosen), dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _turn(found: pd.Series, true: pd.Series, circle: float | np.ndarray) -> np.ndarray:
    """Return the signed smaller angle from true to measured directions, modulo `circle`."""
    return (found.to_numpy() - true.to_numpy() + circle / 2) % circle - circle / 2


def measurement_errors(found: pd.DataFrame, truth: pd.DataFrame) -> pd.DataFrame:
    """Return the errors of measures, object by object."""
    if len(found) != len(truth):
        raise DataError(f"{len(found)} measured objects cannot be compared with {len(truth)} true ones")
    truth = truth.set_axis(found.index)
    errors = pd.DataFrame({"class": [TAXONOMY_NAMES[code] for code in truth["label"]], "design": truth["design"]})
    errors = errors.set_axis(found.index)
    errors["base"] = np.hypot(*(found[["x", "y"]].to_numpy() - place_of(truth)).T)
    errors["elevation"] = found["z"] - truth["z"]
    for name in ("height", "tilt", "panel_bottom", "panel_centre", "panel_height", "panel_width", "length", "width"):
        errors[name] = found[name] - truth[name]
    leans = (truth["tilt"] >= LEAST_LEAN).to_numpy()
    errors["lean_azimuth"] = np.where(leans, _turn(found["lean_azimuth"], truth["lean_azimuth"], 360.0), np.nan)
    two_sided = (truth["design"] == "street_name_sign").to_numpy()
    circle = np.where((found["facing_from"] == "unknown").to_numpy() | two_sided, 180.0, 360.0)
    errors["facing"] = _turn(found["facing"], truth["panel_azimuth"], circle)
    errors["heading"] = _turn(found["heading"], 90.0 - np.degrees(truth["heading"]), 180.0)
    vehicle = (found["kind"] == "vehicle").to_numpy()
    errors.loc[~vehicle, ["heading", "length", "width"]] = np.nan
    return errors[["class", "design", *UNITS]]


def summarise_errors(errors: pd.DataFrame) -> pd.DataFrame:
    """Summarise errors by class and measure."""
    rows = []
    for name, group in errors.groupby("class", sort=True):
        for measure, unit in UNITS.items():
            values = group[measure].dropna().to_numpy()
            if len(values):
                size = np.abs(values)
                rows.append(
                    (name, measure, unit, len(values), np.median(values), np.median(size), np.quantile(size, 0.9))
                )
    return pd.DataFrame(rows, columns=["class", "measure", "unit", "n", "bias", "median", "quantile_90"])


def kinds_of_truth(truth: pd.DataFrame, kinds: Mapping[str, str]) -> pd.DataFrame:
    """Return the true objects that an inventory can contain, with their kinds."""
    kind = truth["label"].map(lambda code: kinds.get(TAXONOMY_NAMES[code]))
    return truth.assign(kind=kind)[kind.notna() & ~truth["moving"].astype(bool)].reset_index(drop=True)
