"""Draw what the inventory measures on objects of a simulated street: `docs/images/inventory_measures.png`.

    python benchmarks/inventory_picture.py [--preset demo] [--seed 4] [--out docs/images/inventory_measures.png]

Of each kind the object with most points that stands still is drawn: points, axis, base, panel, box and footprint.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pandas as pd
import shapely
from inventory_accuracy import RULES
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.inventory.objects.extraction import measure_points
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS
from mlsroad_pipeline.algorithms.inventory.scoring.measure_errors import kinds_of_truth
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

LINE, BASE = "#d9480f", "#c2255c"
Row = dict[str, float]


def direction(degrees: float) -> np.ndarray:
    """Return the unit vector of an azimuth."""
    return np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])


def side_view(axes: Axes, local: np.ndarray, along: np.ndarray) -> None:
    """Draw points as seen from the side, heights above the base."""
    axes.scatter(local[:, :2] @ along, local[:, 2], s=1.2, c="#495057", linewidths=0, alpha=0.6)
    axes.axhline(0, color="#adb5bd", lw=0.8)
    axes.plot(0, 0, "o", color=BASE, ms=6, zorder=5)
    axes.annotate("base", (0, 0), (6, 6), textcoords="offset points", color=BASE, fontsize=8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_ylabel("above the base, m")


def height_bar(axes: Axes, at: float, low: float, high: float, text: str) -> None:
    """Draw a measured height."""
    axes.annotate("", (at, low), (at, high), arrowprops={"arrowstyle": "<->", "color": LINE, "lw": 1})
    axes.annotate(text, (at, (low + high) / 2), (4, 0), textcoords="offset points", color=LINE, fontsize=8, va="center")


def draw_pole(axes: Axes, local: np.ndarray, row: Row) -> None:
    """Draw axis, tilt and height of a pole in the plane of its longer side."""
    spread = local[:, :2][local[:, 2] > 0.6 * row["height"]]
    along = np.linalg.svd(spread - spread.mean(axis=0), full_matrices=False)[2][0]
    side_view(axes, local, along)
    towards = 0.0 if np.isnan(row["lean_azimuth"]) else float(direction(row["lean_azimuth"]) @ along)
    top = np.tan(np.radians(row["tilt"])) * towards * row["height"]
    axes.plot([0, top], [0, row["height"]], color=LINE, lw=1.5)
    height_bar(axes, -0.8, 0, row["height"], f"height {row['height']:.2f} m")
    axes.set_title(f"pole: tilt {row['tilt']:.2f}°, diameter {row['diameter']:.2f} m", fontsize=9)


def draw_sign(axes: Axes, local: np.ndarray, row: Row) -> None:
    """Draw the panel of a sign from its front."""
    right = direction(row["facing"] - 90.0)
    side_view(axes, local, right)
    middle = float(np.median(local[(local[:, 2] > row["panel_bottom"]), :2] @ right))
    left, width = middle - row["panel_width"] / 2, row["panel_width"]
    axes.add_patch(
        mpl.patches.Rectangle((left, row["panel_bottom"]), width, row["panel_height"], fill=False, ec=LINE, lw=1.5)
    )
    height_bar(axes, left - 0.15, 0, row["panel_bottom"], f"panel_bottom {row['panel_bottom']:.2f} m")
    size = f"{row['panel_width']:.2f} x {row['panel_height']:.2f} m"
    axes.set_title(f"sign from its front: panel {size}, facing {row['facing']:.0f}°", fontsize=9)


def draw_vehicle(axes: Axes, local: np.ndarray, row: Row) -> None:
    """Draw box, heading and footprint of a vehicle in plan."""
    axes.scatter(*local[:, :2].T, s=1.2, c="#495057", linewidths=0, alpha=0.5)
    along, across = direction(row["heading"]) * row["length"] / 2, direction(row["heading"] + 90) * row["width"] / 2
    corners = np.array([along + across, along - across, -along - across, -along + across, along + across])
    axes.plot(*corners.T, color=LINE, lw=1.5)
    axes.annotate("", along, (0, 0), arrowprops={"arrowstyle": "->", "color": LINE})
    axes.plot(0, 0, "o", color=BASE, ms=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_ylabel("north, m")
    size = f"{row['length']:.2f} x {row['width']:.2f} m"
    axes.set_title(f"vehicle in plan: {size}, heading {row['heading']:.0f}°", fontsize=9)


def draw_tree(axes: Axes, local: np.ndarray, row: Row, footprint: str, base: np.ndarray) -> None:
    """Draw a tree in plan: its crown's circle, its footprint and its foot."""
    axes.scatter(*local[:, :2].T, s=1.2, c="#495057", linewidths=0, alpha=0.25)
    hull = shapely.get_coordinates(shapely.from_wkt(footprint)) - base
    axes.plot(*hull.T, color=LINE, lw=1.5)
    middle = shapely.get_coordinates(shapely.centroid(shapely.polygons(hull)))[0]
    axes.add_patch(mpl.patches.Circle(middle, row["crown_diameter"] / 2, fill=False, ec="#2b8a3e", lw=1.2, ls="--"))
    axes.plot(0, 0, "o", color=BASE, ms=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_ylabel("north, m")
    axes.set_title(f"tree in plan: crown {row['crown_diameter']:.2f} m, height {row['height']:.2f} m", fontsize=9)


def main() -> None:
    """Simulate, choose, measure, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="demo", choices=list(PRESETS))
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--out", default="docs/images/inventory_measures.png")
    options = parser.parse_args()
    mpl.use("Agg")
    parameters = replace(PRESETS[options.preset], seed=options.seed, with_images=False, street=STREETS["town"])
    survey = simulate_survey(parameters, n_threads=os.cpu_count() or 1)
    cloud, truth = survey.cloud, kinds_of_truth(survey.objects, KIND_OF_CLASS)
    height = find_ground(cloud, GroundParameters())["height"]
    points = pd.Series(cloud["instance"]).value_counts()
    truth = truth.assign(points=truth["instance"].map(points)).sort_values("points", ascending=False)
    figure, axes = plt.subplots(2, 2, figsize=(10, 9), layout="constrained")
    for place, name in zip(axes.flat, ("light_pole", "traffic_sign", "car", "tree"), strict=True):
        of_class = truth[truth["label"] == TAXONOMY[name]]
        one = of_class[~of_class["design"].isin(["several_plates_sign", "two_post_sign", "street_name_sign"])].iloc[0]
        rule = RULES[TAXONOMY_NAMES[one["label"]]]
        mine = (cloud["instance"] == one["instance"]) & np.isfinite(height) & np.isin(cloud["label"], rule.labels)
        row = measure_points(cloud.xyz[mine], rule, height_above_ground=height[mine], origin=survey.origin)
        numbers = {key: float(value) for key, value in row.items() if not isinstance(value, str)}
        base = np.array([numbers["x"], numbers["y"], numbers["z"]])
        local = cloud.xyz[mine] + survey.origin - base
        if rule.kind == "tree":
            draw_tree(place, local, numbers, str(row["footprint"]), base[:2])
        else:
            {"pole": draw_pole, "sign": draw_sign, "vehicle": draw_vehicle}[rule.kind](place, local, numbers)
        place.tick_params(labelsize=8)
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
