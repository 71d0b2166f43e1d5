"""Draw what is hard to segment, by every segmentation: `docs/images/segmentation_hard_cases.jpg`.

    python benchmarks/hard_case_pictures.py [--seed 9101] [--out docs/images/segmentation_hard_cases.jpg]

The cases are those of Yu et al. 2016, Figure 11: a pole in a palm, shrubs that touch, and cars under trees, on a ring
road and a campus with many of them, as the VMX-450 scans them in two passes. Drawn is the case whose smallest object
has most points, or the tree with most points above cars, whatever comes out. The objects of a case are those that
share a Euclidean cluster of 0.15 m, or stand below.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.metrics.instances import find_overlaps
from mlsroad_pipeline.algorithms.segmentation.euclidean import cluster
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters, segment_scene
from mlsroad_pipeline.papers.yu2016.study.objects import TOUCHING
from mlsroad_pipeline.papers.yu2016.study.streets import make_survey
from mlsroad_pipeline.simulation import PRESETS
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

METHODS = ("normalized_cut", "normalized_cut_plain", "yang_dong", "two_step")
LEAST = 800  # points of an object in a case
COLOURS = ("#d9480f", "#2b8a3e", "#1971c2", "#9c36b5", "#e8b100", "#0b7285", "#c2255c", "#5c940d")
OTHERS, GREY = ("#868e96", "#adb5bd", "#495057", "#ced4da"), "#e9ecef"


def street(kind: str, seed: int) -> PointCloud:
    """Simulate a street full of hard cases."""
    made = replace(
        PRESETS["vmx450"], seed=seed, length=50.0, speed=6.0, passes=2, with_images=False,
        street=replace(STREETS[kind], junction_spacing=0.0, hard_cases=1.0, lamp_spacing=14.0, traffic=0.0,
                       overhead_wires=0.0, parking=1.0, parked=0.8),
    )  # fmt: skip
    return make_survey(simulation=made, ground=GroundParameters())["points"]


def labelled(scene: PointCloud, *names: str) -> np.ndarray:
    """Return the instances of some classes with enough points."""
    rows = np.isin(scene["label"], [TAXONOMY[name] for name in names]) & scene["core"] & ~scene["ground"]
    numbers, counts = np.unique(scene["instance"][rows], return_counts=True)
    return numbers[(counts >= LEAST) & (numbers > 0)]


def joined(scene: PointCloud, one: np.ndarray, other: np.ndarray) -> list[list[int]]:
    """Return the instances of two kinds that lie in one cluster, that whose smallest is largest first."""
    off = np.flatnonzero(~scene["ground"] & np.isin(scene["instance"], np.union1d(one, other)))
    together = cluster(np.ascontiguousarray(scene.xyz[off], dtype=np.float64), tolerance=TOUCHING)
    pairs = find_overlaps(scene["instance"][off], together)
    cases = []
    for number in range(len(pairs.segments)):
        inside = (pairs.segment == number) & (pairs.shared >= LEAST)
        members = pairs.instances[pairs.instance[inside]]
        if len(members) > 1 and np.isin(members, one).any() and np.isin(members, other).any():
            cases.append((int(pairs.shared[inside].min()), members.tolist()))
    return [members for _, members in sorted(cases, reverse=True)]


def pole_in_palm(scene: PointCloud) -> list[int]:
    """Return a lamp or a sign and the palm that it stands in."""
    poles, palms = labelled(scene, "light_pole", "traffic_sign"), labelled(scene, "palm")
    return next(case for case in joined(scene, poles, palms) if len(case) == 2)


def shrubs(scene: PointCloud) -> list[int]:
    """Return shrubs that touch."""
    low = labelled(scene, "brushwood", "cycas", "hedge")
    return next(case for case in joined(scene, low, low) if 2 <= len(case) <= 5)


def cars_under_tree(scene: PointCloud) -> list[int]:
    """Return the tree with the most points above cars, and these."""
    best: tuple[int, list[int]] = (0, [])
    cars = labelled(scene, "car", "van")
    for tree in labelled(scene, "tree").tolist():
        crown = scene.xyz[scene["instance"] == tree][:, :2]
        below, above = [tree], 0
        for car in cars.tolist():
            low, high = (f(scene.xyz[scene["instance"] == car][:, :2], axis=0) for f in (np.min, np.max))
            n = int(((crown >= low) & (crown <= high)).all(axis=1).sum())
            if n >= LEAST:
                below.append(car)
                above += n
        best = max(best, (above, below))
    if not best[1]:
        raise SystemExit("no car stands under a tree: another --seed")
    return best[1]


def plane(scene: PointCloud, members: list[int], from_above: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the points near a case, and where they are drawn, metres: from the side, or from above."""
    own = np.isin(scene["instance"], members)
    low, high = scene.xyz[own].min(axis=0) - 0.5, scene.xyz[own].max(axis=0) + 0.5
    rows = np.flatnonzero(((scene.xyz >= low) & (scene.xyz <= high)).all(axis=1) & ~scene["ground"])
    flat = scene.xyz[rows, :2].astype(np.float64)
    middle = scene.xyz[own][:, :2].mean(axis=0)
    axes = np.linalg.eigh(np.cov((scene.xyz[own][:, :2] - middle).T))[1]
    along = (flat - middle) @ axes[:, 1]
    up = (flat - middle) @ axes[:, 0] if from_above else scene.xyz[rows, 2] - scene.xyz[own][:, 2].min()
    return rows, np.column_stack([along, up])


def paint(scene: PointCloud, rows: np.ndarray, members: list[int], found: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return a colour for each point, that of the member that its segment fits best, and the IoU of each member."""
    own = np.where(np.isin(scene["instance"], members), scene["instance"], 0)
    pairs = find_overlaps(own, found)
    colours = np.full(len(found), GREY, dtype="<U7")
    iou = []
    numbers = np.unique(found[rows][found[rows] >= 0])
    for rank, segment in enumerate(numbers.tolist()):
        colours[found == segment] = OTHERS[rank % len(OTHERS)]
    for rank, member in enumerate(members):
        mine = np.flatnonzero(pairs.instances[pairs.instance] == member)
        best = mine[np.argmax(pairs.iou[mine])]
        iou.append(float(pairs.iou[best]))
        # A segment that several members share is that of the one it fits best.
        rivals = pairs.iou[(pairs.segment == pairs.segment[best]) & (pairs.instances[pairs.instance] > 0)]
        if pairs.iou[best] == rivals.max():
            colours[found == pairs.segments[pairs.segment[best]]] = COLOURS[rank % len(COLOURS)]
    return colours[rows], iou


def draw(axes: Axes, at: np.ndarray, colours: np.ndarray, title: str) -> None:
    """Draw points in an order that hides none behind another colour."""
    order = np.random.default_rng(0).permutation(len(at))[:60000]
    axes.scatter(*at[order].T, c=colours[order], s=0.35, linewidths=0)
    axes.set_title(title, fontsize=8)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6)


def main() -> None:
    """Simulate, segment and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=9101)
    parser.add_argument("--out", default="docs/images/segmentation_hard_cases.jpg")
    options = parser.parse_args()
    mpl.use("Agg")
    cases: list[tuple[str, str, Callable[[PointCloud], list[int]], bool]] = [
        ("a pole in a palm", "ring_road", pole_in_palm, False),
        ("shrubs that touch, from above", "ring_road", shrubs, True),
        ("cars under a tree", "campus", cars_under_tree, False),
    ]
    scenes = {kind: street(kind, options.seed) for kind in ("ring_road", "campus")}
    found = {
        (kind, method): segment_scene(scene, {"ground": scene["ground"]}, SegmentationParameters(method))["objects"]
        for kind, scene in scenes.items()
        for method in METHODS
    }
    figure, panels = plt.subplots(len(cases), 1 + len(METHODS), figsize=(15, 9.5), layout="constrained")
    for row, (name, kind, choose, from_above) in zip(panels, cases, strict=True):
        scene = scenes[kind]
        members = choose(scene)
        rows, at = plane(scene, members, from_above)
        for axes, method in zip(row, ("reference", *METHODS), strict=True):
            objects = scene["instance"].astype(np.int32) - 1 if method == "reference" else found[kind, method]
            colours, iou = paint(scene, rows, members, objects)
            draw(axes, at, colours, f"{method}: IoU " + ", ".join(f"{value:.2f}" for value in iou))
            print(f"{name}: {method} {np.round(iou, 3).tolist()}", flush=True)
        row[0].set_title("reference", fontsize=8)
        row[0].set_ylabel(name, fontsize=9)
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
