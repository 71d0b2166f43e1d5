"""Simulated surveys beside recordings: density, incidence, noise, shares and shapes, as figures and JSON.

    python benchmarks/realism.py [oakland semantickitti taiwan_poles amsterdam] [--seeds 101 102 103] [--kind KIND]

Every recording below $MLSROAD_DATA is described by `simulation/realism.py` and `compute_eigen_features`, and
so are streets that are simulated with the preset whose scanner is nearest to the recording's. Prints a table and one
JSON line per recording, and writes one picture each for the first two.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import matplotlib as mpl
import numpy as np
from transfer import CONF, LENGTH, PRESET, Recording, configured

from mlsroad_pipeline.algorithms.core.classes import IGNORE, TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.features.eigen import compute_eigen_features
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS
from mlsroad_pipeline.simulation.realism import (
    binned_quantiles,
    distribution_gap,
    fit_scan_lines,
    incidence_angles,
    plane_residuals,
    surface_density,
)

mpl.use("Agg")
import matplotlib.pyplot as plt

DATA = Path(os.environ.get("MLSROAD_DATA", CONF.parents[1] / "shared/data"))
SHAPES = ("linearity", "planarity", "scattering", "verticality", "neighbor_count")
RADIUS = 0.6  # metres
FLATNESS = 0.4  # planarity above which a neighbourhood has a normal
ASIDE = 0.15  # metres that a point may lie beside the plane of its scan line
RANGES = {"oakland": np.arange(1.0, 21.0), "semantickitti": np.arange(3.0, 43.0, 2.0)}
COLOURS = {"recorded": "#1f3fae", "simulated": "#d2601a"}
FLAT = {"oakland": ("ground", "facade"), "semantickitti": ("man-made terrain", "building")}
SCHEME = {"oakland": "oakland7", "semantickitti": "tomic2019"}


def sensor_places(name: str, xyz: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """Return where the scanner was when it measured each point, and what its scan lines tell."""
    if name == "semantickitti":
        return np.zeros_like(xyz), {}
    lines = fit_scan_lines(xyz)
    if len(lines.first) < 100:
        return np.full_like(xyz, np.nan), {}
    # A point is of the line whose upright plane is nearest to it, if that is near.
    place = np.full_like(xyz, np.nan)
    for rows in np.array_split(np.arange(len(xyz)), len(xyz) // 2000 + 1):
        away = xyz[rows, None, :2] - lines.nadir[None, :, :2]
        across = np.abs(away[..., 0] * lines.direction[:, 1] - away[..., 1] * lines.direction[:, 0])
        across[(away * lines.direction).sum(axis=2) <= 0] = np.inf
        line = across.argmin(axis=1)
        near = across[np.arange(len(rows)), line] < ASIDE
        place[rows[near]] = lines.nadir[line[near]]
        place[rows[near], 2] += lines.height[line[near]]
    spacing = np.linalg.norm(np.diff(lines.nadir, axis=0), axis=1)
    nearest = np.hypot(*(xyz[lines.first, :2] - lines.nadir[:, :2]).T)
    found = {
        "height": lines.height, "step": lines.step, "reach": lines.reach, "spacing": spacing,
        "first_angle": np.degrees(np.arctan2(nearest, lines.height)),
    }  # fmt: skip
    return place, found


def describe(name: str, clouds: list[PointCloud], scheme: ClassScheme) -> dict[str, Any]:
    """Describe clouds of one kind, joined: values per point with its class, and values per cell and line."""
    parts: dict[str, list[np.ndarray]] = {}
    for cloud in clouds:
        xyz = cloud.xyz.astype(np.float64)
        label = scheme.encode(cloud["label"], source=cloud.source)
        sensor, lines = sensor_places(name, xyz)
        shape = compute_eigen_features(xyz, radius=RADIUS)
        normals = np.column_stack([shape[axis] for axis in ("nx", "ny", "nz")])
        normals[~(shape["planarity"] > FLATNESS)] = np.nan  # a single scan line has no normal
        density = np.full(len(xyz), np.nan)
        flat = label == scheme.classes.index(FLAT[name][0])
        density[flat] = surface_density(xyz[flat])
        values = {
            "label": label, "range": np.hypot(*(xyz - sensor)[:, :2].T), "density": density,
            "incidence": incidence_angles(xyz, normals, sensor), **{s: shape[s] for s in SHAPES}, **lines,
        }  # fmt: skip
        if "intensity" in cloud:
            values["intensity"] = cloud["intensity"]
        for kind in FLAT[name]:
            values[f"scatter {kind}"] = plane_residuals(xyz[label == scheme.classes.index(kind)])[0]
        for key, column in values.items():
            parts.setdefault(key, []).append(np.asarray(column))
    return {key: np.concatenate(columns) for key, columns in parts.items()}


def spread(values: np.ndarray) -> list[float]:
    """Return quartiles, for a table."""
    return np.round(np.nanquantile(values, [0.25, 0.5, 0.75]), 4).tolist()


def summary(name: str, found: dict[str, Any], scheme: ClassScheme) -> dict[str, Any]:
    """Return what a table says of a description."""
    known = found["label"][found["label"] != IGNORE]
    shares = np.bincount(known, minlength=len(scheme)) / len(known)
    out: dict[str, Any] = {"points": len(found["label"])}
    out["shares"] = {c: round(float(s), 4) for c, s in zip(scheme.classes, shares, strict=True)}
    keys = [k for k in ("height", "step", "first_angle", "spacing", "reach", "incidence") if k in found]
    for key in (*keys, *(f"scatter {kind}" for kind in FLAT[name])):
        out[key] = np.round(np.nanquantile(found[key], [0.25, 0.5, 0.75]), 4).tolist()
    if "intensity" in found:
        parts = {c: found["intensity"][found["label"] == i] for i, c in enumerate(scheme.classes)}
        out["intensity"] = {c: spread(part) for c, part in parts.items() if len(part) >= 50}
    at = (3.0, 5.0, 8.0, 12.0, 16.0, 24.0, 32.0, 40.0)
    middle = binned_quantiles(found["density"], found["range"], at, shares=(0.5,))[:, 0]
    out["density"] = dict(zip(map(str, at[:-1]), np.round(middle, 1).tolist(), strict=True))
    return out


def gaps(recorded: dict[str, Any], simulated: dict[str, Any], scheme: ClassScheme) -> dict[str, dict[str, float]]:
    """Return the gap between the distributions of each shape, and of intensity, within each class that both have."""
    out: dict[str, dict[str, float]] = {}
    keys = [*SHAPES, *(["intensity"] if "intensity" in recorded else [])]
    for c, name in enumerate(scheme.classes):
        rows = [d["label"] == c for d in (recorded, simulated)]
        if min(row.sum() for row in rows) >= 50:
            pairs = {key: (recorded[key][rows[0]], simulated[key][rows[1]]) for key in keys}
            out[name] = {key: round(distribution_gap(a, b), 3) for key, (a, b) in pairs.items()}
    return out


def draw(name: str, both: dict[str, dict[str, Any]], found: dict[str, Any], scheme: ClassScheme, path: Path) -> None:
    """Draw shares, density, incidence, scatter and shapes of both."""
    figure, axes = plt.subplots(2, 3, figsize=(13, 7), layout="constrained")
    places = np.arange(len(scheme))
    for offset, (kind, values) in zip((-0.2, 0.2), both.items(), strict=True):
        colour = COLOURS[kind]
        shares = [100 * found[kind]["shares"][c] for c in scheme.classes]
        axes[0, 0].bar(places + offset, np.maximum(shares, 1e-3), 0.4, color=colour, label=kind)
        low, middle, high = binned_quantiles(values["density"], values["range"], RANGES[name]).T
        at = (RANGES[name][1:] + RANGES[name][:-1]) / 2
        axes[0, 1].plot(at, middle, color=colour)
        axes[0, 1].fill_between(at, low, high, color=colour, alpha=0.2)
        incidence = values["incidence"][np.isfinite(values["incidence"])]
        axes[0, 2].hist(incidence, bins=45, range=(0, 90), density=True, histtype="step", color=colour)
        for flat, style in zip(FLAT[name], ("-", "--"), strict=True):
            scatter = 100 * values[f"scatter {flat}"]
            if len(scatter):
                where, name_of = np.linspace(0, 6, 50), f"{kind}, {flat}"
                axes[1, 0].hist(scatter, where, density=True, histtype="step", color=colour, ls=style, label=name_of)
        for row, key in enumerate(("linearity", "planarity", "scattering")):
            for c in places:
                column = values[key][values["label"] == c]
                if np.isfinite(column).sum() >= 50:
                    low, middle, high = np.nanquantile(column, [0.25, 0.5, 0.75])
                    y = c + offset / 2 + (row - 1) * 0.27
                    axes[1, 1].plot([low, high], [y, y], color=colour, lw=1)
                    axes[1, 1].plot(middle, y, "os^"[row], color=colour, ms=3.5)
    axes[0, 0].set(yscale="log", ylabel="per cent of the points", title="shares")
    axes[0, 0].set_xticks(places, scheme.classes, rotation=40, ha="right", fontsize=7)
    axes[0, 0].legend(fontsize=8)
    axes[0, 1].set(yscale="log", xlabel="range in plan, m", ylabel="points per m²", title="density on the ground")
    axes[0, 2].set(xlabel="angle between beam and normal, degrees", title="incidence")
    axes[1, 0].set(xlabel="standard deviation about planes of 0.5 m, cm", title="scatter")
    axes[1, 0].legend(fontsize=7)
    axes[1, 1].set(xlim=(0, 1), title="linearity (dot), planarity (square), scattering (triangle)")
    axes[1, 1].set_yticks(places, scheme.classes, fontsize=7)
    table = found["gaps"]
    columns = list(next(iter(table.values())))
    picture = axes[1, 2].imshow([[row[c] for c in columns] for row in table.values()], vmin=0, vmax=1, cmap="viridis")
    axes[1, 2].set_xticks(range(len(columns)), columns, rotation=30, ha="right", fontsize=7)
    axes[1, 2].set_yticks(range(len(table)), list(table), fontsize=7)
    axes[1, 2].set_title("gap of distributions (0 is the same)")
    figure.colorbar(picture, ax=axes[1, 2])
    figure.savefig(path, dpi=75, pil_kwargs={"quality": 80})


def compare(name: str, seeds: list[int], kind: str | None, output: Path) -> None:
    """Describe a recording and the streets of its preset."""
    recording = Recording(name)
    schemes = configured("classes", name)["schemes"]
    scheme = ClassScheme.from_config(SCHEME[name], schemes[SCHEME[name]])
    if name == "oakland":
        recorded = [cloud for cloud, _ in recording.scenes().values()]
    else:
        recorded = [recording.read(path) for path in sorted(recording.root.glob("*.bin"))]
    preset = replace(PRESETS[PRESET[name]], length=LENGTH[name])
    if kind:
        preset = replace(preset, street=STREETS[kind])
    simulated = [cloud for seed in seeds for cloud in recording.simulate(replace(preset, seed=seed))]
    both = {which: describe(name, c, scheme) for which, c in (("recorded", recorded), ("simulated", simulated))}
    found: dict[str, Any] = {which: summary(name, values, scheme) for which, values in both.items()}
    found["gaps"] = gaps(both["recorded"], both["simulated"], scheme)
    for which in both:
        print(name, which, json.dumps(found[which], indent=1))
    for row, values in found["gaps"].items():
        print(f"{row:20s}", values)
    print(json.dumps({"recording": name, **found}), flush=True)
    draw(name, both, found, scheme, output / f"realism_{name}.jpg")


def poles(seeds: list[int]) -> None:
    """Compare recorded and simulated street lights of a VMQ-1HA: spacing, intensity and shape."""
    recorded = []
    for path in sorted((DATA / "taiwan_poles").glob("SL_*.csv.gz")):
        table = np.loadtxt(path, delimiter=",")
        recorded.append((table[:, :3] / 1000.0, table[:, 3] / 65535.0))
    simulated = []
    for seed in seeds:
        cloud = simulate_survey(replace(PRESETS["vmq1ha"], seed=seed, length=60.0, with_images=False)).cloud
        lamps = np.unique(cloud["instance"][cloud["label"] == TAXONOMY["light_pole"]])
        for instance in lamps[lamps > 0]:
            rows = np.flatnonzero(cloud["instance"] == instance)
            if len(rows) > 200:
                simulated.append((cloud.xyz[rows].astype(np.float64), cloud["intensity"][rows]))
    out: dict[str, Any] = {"recording": "taiwan_poles"}
    for kind, objects in (("recorded", recorded), ("simulated", simulated)):
        shapes = [compute_eigen_features(xyz, radius=0.3) for xyz, _ in objects]
        out[kind] = {
            "objects": len(objects),
            "points": spread(np.array([len(xyz) for xyz, _ in objects])),
            "height": spread(np.array([np.ptp(xyz[:, 2]) for xyz, _ in objects])),
            "intensity": spread(np.concatenate([intensity for _, intensity in objects])),
            **{key: spread(np.concatenate([s[key] for s in shapes])) for key in ("linearity", "scattering")},
        }
    print(json.dumps(out), flush=True)


def pavement(seeds: list[int]) -> None:
    """Compare the flat of a recorded pavement with simulated ground: density and scatter about planes."""
    las = laspy.read(next((DATA / "amsterdam").glob("*.laz")))
    xyz = np.asarray(las.xyz) - np.asarray(las.xyz).min(axis=0)
    low = np.quantile(xyz[:, 2], 0.5) + 0.3
    streets = [simulate_survey(replace(PRESETS["demo"], seed=s, length=40.0, with_images=False)).cloud for s in seeds]
    clouds = {"recorded": [xyz[xyz[:, 2] < low]]}
    ground = [TAXONOMY[c] for c in ("road", "sidewalk", "parking", "curb", "lane_marking")]
    clouds["simulated"] = [c.xyz[np.isin(c["label"], ground)] for c in streets]
    out: dict[str, Any] = {"recording": "amsterdam"}
    for kind, parts in clouds.items():
        out[kind] = {
            "density": spread(np.concatenate([surface_density(part) for part in parts])),
            "scatter": spread(np.concatenate([plane_residuals(part)[0] for part in parts])),
        }
    print(json.dumps(out), flush=True)


def main() -> None:
    """Compare the recordings that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = ["oakland", "semantickitti", "taiwan_poles", "amsterdam"]
    parser.add_argument("recordings", nargs="*", default=names, help=f"some of {', '.join(names)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[101, 102, 103])
    parser.add_argument("--kind", choices=list(STREETS), help="kind of street; the presets' own by default")
    parser.add_argument("--output", type=Path, default=Path("data/08_reporting/benchmarks"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.recordings:
        if name == "taiwan_poles":
            poles(options.seeds)
        elif name == "amsterdam":
            pavement(options.seeds)
        elif name in PRESET:
            compare(name, options.seeds, options.kind, options.output)
        else:
            parser.error(f"recording {name!r} is unknown (recordings: {', '.join(names)})")


if __name__ == "__main__":
    main()
