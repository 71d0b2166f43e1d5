"""Scores of the lines of `label`, with the shipped model, on simulated streets and on recordings.

    python benchmarks/line_scores.py [--only simulated semantickitti ...] [--folder FOLDER]

- simulated: streets of 100 m of four kinds (town, suburb, ring_road, campus), seen by two scanners (presets `demo`, a
  sixth of the pulses of a VMX-450, and `hdl32`), seeds that nothing was chosen on. A true kerb counts if it is at least
  5 cm high and both of its sides have points in four cells of 0.1 m within 0.35 m; lower and hidden ones are uncounted.
  A true wire reaches from its first to its last point, in space, and counts if it has 50 points and is 3 m long. Walls
  and fences count where eight of their voxels of 0.1 m, markings where three cells of 0.1 m of paint have points within
  0.35 m; crossings are scored along their middle. Other paint, such as arrows, is uncounted;
- semantickitti, pandaset: scans of SemanticKITTI 00 and frames of PandaSet 001, each labelled alone. The reference is
  the border between points of road or parking and of sidewalk, at most 0.5 m apart; borders to other ground are
  uncounted. Not every such border is a kerb;
- kitti_kerbs: scans of KITTI, points of kerbs picked by hand; lines farther than 2 m from them are left out;
- pandaset_merged: the four frames of PandaSet 001 as one cloud. The reference of markings is the shortest tree through
  the middles of points of lane lines, stop lines and other road markings, in groups of at least 1 m.

Recordings lie below $MLSROAD_DATA. Prints a table in Markdown and writes `line_scores.json` into the folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import geopandas
import laspy
import numpy as np
import shapely
from _common import DATA, PANDASET, RESULTS, STREETS, mlsroad, parser, simulated_street
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.inventory.scoring.line_scores import LineScores, places_along, score_lines
from mlsroad_pipeline.simulation.furnishing.premises import Frame
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.simulation.street.line_truth import true_kerbs, true_markings

FIRST_SEED, LENGTH = 931, 100
LEAST, NEAR, CELLS = 0.05, 0.35, 4  # metres, metres, cells on either side
PAINTED, VOXELS = 3, 8  # cells, voxels within `NEAR`
WITHIN = (0.1, 0.2, 0.5)
Places = tuple[NDArray[np.float64], NDArray[np.float64]]


class Case(NamedTuple):
    """A survey, its true lines as places every 0.1 m, counted and uncounted; None: not known."""

    name: str
    survey: Path
    kerbs: Places | None
    wires: Places | None = None
    markings: Places | None = None
    barriers: Places | None = None
    near: float = np.inf  # listed lines farther from the true ones are left out, metres


def seen(kerbs: NDArray[np.float64], xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which places of kerbs have points on both sides, in enough cells of 0.1 m."""
    near = cKDTree(kerbs[:, :2]).query(xyz[:, :2], distance_upper_bound=NEAR)[0] < NEAR
    cells = np.unique(np.round(xyz[near] / (0.1, 0.1, 0.02)).astype(np.int64), axis=0) * (0.1, 0.1, 0.02)
    tree = cKDTree(cells[:, :2])
    both = np.zeros(len(kerbs), dtype=bool)
    for k, (x, y, foot, height) in enumerate(kerbs):
        around = cells[tree.query_ball_point((x, y), NEAR)]
        share = (around[:, 2] - foot) / max(height, 1e-6)
        sides = (np.abs(share) < 0.3, np.abs(share - 1.0) < 0.3)
        both[k] = all(len(np.unique(np.round(around[side, :2], 2), axis=0)) >= CELLS for side in sides)
    return both


def simulated(folder: Path) -> Iterator[Case]:
    """Yield the streets, simulated where they are not there."""
    for number, (kind, scanner) in enumerate(STREETS):
        street = simulated_street(folder, kind, scanner, FIRST_SEED + number, LENGTH)
        described = {"preset": scanner, "seed": FIRST_SEED + number, "length": LENGTH, "street": kind}
        stream = SurveyStream(simulation_parameters({**described, "with_images": False}))
        kerbs = true_kerbs(stream.street, start=-40.0, end=LENGTH + 40.0)
        kerbs[:, :3] += stream.origin
        high, counted = kerbs[:, 3] >= LEAST, np.zeros(len(kerbs), dtype=bool)
        points = laspy.read(street / "survey.laz")
        counted[high] = seen(kerbs[high], np.asarray(points.xyz))
        paint = true_paint(stream, points)
        lines = (kerbs[counted, :2], kerbs[~counted, :2]), true_wires(points), paint, true_barriers(stream, points)
        yield Case(street.name, street, *lines)


def true_barriers(stream: SurveyStream, points: laspy.LasData) -> Places:
    """Return places along the walls and fences of a simulated street that count, and along the others."""
    street, places = stream.street, [np.zeros((0, 2))]
    for lot in (lot for lot in street.lots if lot.boundary in ("fence", "wall")):
        frame, way = Frame(SimpleNamespace(street=street), lot), np.arange(lot.start + 0.05, lot.end, 0.1)
        line = np.array([frame.place(at, 0.3) for at in way[~(np.abs(way - lot.driveway) < 1.6)]]).reshape(-1, 2)
        places.append(street.alignment.place(*line.T)[0][:, :2] + stream.origin[:2])
    own = np.isin(np.asarray(points["label"]), [TAXONOMY["wall"], TAXONOMY["fence"]])
    voxels = np.unique(np.round(np.asarray(points.xyz)[own], 1), axis=0)
    near = cKDTree(voxels[:, :2]).query_ball_point(np.concatenate(places), NEAR, return_length=True)
    return np.concatenate(places)[near >= VOXELS], np.concatenate(places)[near < VOXELS]


def true_paint(stream: SurveyStream, points: laspy.LasData) -> Places:
    """Return places along the markings of a simulated street that count, and on other paint."""
    markings = true_markings(stream.street, start=-40.0, end=LENGTH + 40.0)
    places, rest = (part[:, :2] + stream.origin[:2] for part in (markings.places, markings.rest))
    painted = np.asarray(points.xyz)[np.asarray(points["label"]) == TAXONOMY["lane_marking"], :2]
    cells = np.unique(np.round(painted, 1), axis=0)
    counted = np.array([len(near) >= PAINTED for near in cKDTree(cells).query_ball_point(places, NEAR)], dtype=bool)
    return places[counted], np.concatenate([places[~counted], rest])


def true_wires(points: laspy.LasData) -> Places:
    """Return places along the wires of a simulated street that count, and along those that do not."""
    label, instance = np.asarray(points["label"]), np.asarray(points["instance"])
    counted, others = [], []
    for number in np.unique(instance[label == TAXONOMY["wire"]]):
        xyz = np.asarray(points.xyz[(instance == number) & (label == TAXONOMY["wire"])])
        middle = xyz.mean(axis=0)
        along = np.linalg.svd(xyz[:, :2] - middle[:2], full_matrices=False)[2][0] if len(xyz) > 1 else np.zeros(2)
        way = (xyz[:, :2] - middle[:2]) @ along
        if len(xyz) < 5 or np.ptp(way) < 0.5:
            continue
        at = np.linspace(way.min(), way.max(), 50)
        line = np.column_stack([middle[:2] + at[:, None] * along, np.polyval(np.polyfit(way, xyz[:, 2], 2), at)])
        (counted if len(xyz) >= 50 and np.ptp(way) >= 3.0 else others).append(line)
    return places_along(counted, solid=True), places_along(others, solid=True)


def border(xyz: NDArray[np.float64], road: NDArray[np.bool_], other: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return places between cells of 0.2 m of two classes, one of each 0.1 m square."""
    sides = [np.unique(np.floor(xyz[side, :2] / 0.2), axis=0) * 0.2 + 0.1 for side in (road, other)]
    if min(map(len, sides)) == 0:
        return np.zeros((0, 2))
    apart, nearest = cKDTree(sides[0]).query(sides[1])
    middle = (sides[1] + sides[0][nearest])[apart < 0.5] / 2
    return np.unique(np.round(middle, 1), axis=0)


def semantickitti(_: Path) -> Iterator[Case]:
    """Yield the full scans."""
    folder = DATA / "real/semantickitti_more/makeonebug"
    for scan in sorted((folder / "pcd").glob("*.bin")):
        xyz = np.fromfile(scan, np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
        code = np.fromfile(folder / "label" / f"{scan.stem}.label", np.uint32) & 0xFFFF
        road = np.isin(code, [40, 44, 60])
        sides = code == 48, np.isin(code, [49, 72])
        yield Case(f"kitti_{scan.stem}", scan, (border(xyz, road, sides[0]), border(xyz, road, sides[1])))


def kitti_kerbs(_: Path) -> Iterator[Case]:
    """Yield the scans."""
    for scan in sorted((DATA / "real/kitti_kerbs").glob("*.laz")):
        points = laspy.read(scan)
        picked = np.unique(np.round(points.xyz[np.isin(points.classification, [1, 2]), :2], 1), axis=0)
        yield Case(scan.stem, scan, (picked, picked[:0]), near=2.0)


def pandaset(_: Path) -> Iterator[Case]:
    """Yield the frames."""
    for frame in sorted(PANDASET.glob("*.npz")):
        with np.load(frame, allow_pickle=False) as arrays:
            xyz, code = arrays["xyz"].astype(np.float64), arrays["label"]
        road = np.isin(code, [7, 8, 9, 10])
        kerbs = border(xyz, road, code == 11), border(xyz, road, np.isin(code, [5, 6, 12]))
        yield Case(f"pandaset_{frame.stem}", frame, kerbs)


def pandaset_merged(folder: Path) -> Iterator[Case]:
    """Yield the frames as one cloud, written as LAS with the device as scanner."""
    parts: dict[str, list[NDArray]] = {name: [] for name in ("xyz", "intensity", "time", "device", "label")}
    for frame in sorted(PANDASET.glob("*.npz")):
        with np.load(frame, allow_pickle=False) as arrays:
            for name, found in parts.items():
                found.append(arrays[name])
    if not parts["xyz"]:
        return
    columns = {name: np.concatenate(found) for name, found in parts.items()}
    cloud = laspy.create(point_format=6, file_version="1.4")
    cloud.header.scales = [0.001] * 3
    cloud.xyz = columns["xyz"]
    cloud.intensity = (columns["intensity"] * 257).astype(np.uint16)
    cloud.gps_time, cloud.scanner_channel = columns["time"] - 1e9, columns["device"]
    folder.mkdir(parents=True, exist_ok=True)
    cloud.write(folder / "pandaset_001.laz")
    paint = columns["xyz"][np.isin(columns["label"], [8, 9, 10]), :2]
    yield Case("pandaset_001", folder / "pandaset_001.laz", None, None, middle_lines(paint))


def middle_lines(paint: NDArray[np.float64]) -> Places:
    """Return places in squares of 0.1 m along the middles of groups of points of paint, and points of short groups."""
    middle = paint.copy()
    for _ in range(3):  # towards the line through the points around
        tree, moved = cKDTree(middle), middle.copy()
        for k, rows in enumerate(tree.query_ball_point(middle, 0.6)):
            around = middle[rows] - middle[rows].mean(axis=0)
            along = np.linalg.svd(around, full_matrices=False)[2][0] if len(rows) > 2 else np.zeros(2)
            moved[k] = middle[rows].mean(axis=0) + ((middle[k] - middle[rows].mean(axis=0)) @ along) * along
        middle = moved
    middle = np.unique(np.round(middle / 0.05), axis=0) * 0.05
    pairs = cKDTree(middle).query_pairs(1.2, output_type="ndarray")
    apart = np.hypot(*(middle[pairs[:, 0]] - middle[pairs[:, 1]]).T)
    graph = coo_array((apart, (pairs[:, 0], pairs[:, 1])), shape=(len(middle),) * 2)
    tree = minimum_spanning_tree(graph).tocoo()
    group = connected_components(graph, directed=False)[1]
    length = np.bincount(group[tree.row], tree.data, minlength=group.max() + 1)
    edges = [middle[[a, b]] for a, b in zip(tree.row, tree.col, strict=True) if length[group[a]] >= 1.0]
    places = np.unique(np.round(np.concatenate([places_along(edges, step=0.02), np.zeros((0, 2))]), 1), axis=0)
    return places, middle[length[group] < 1.0]


SETS = {f.__name__: f for f in (simulated, semantickitti, kitti_kerbs, pandaset, pandaset_merged)}
KINDS_OF = {
    **{name: (name,) for name in ("kerbs", "wires", "barriers")},
    "markings": ("lane_lines", "stop_lines", "crossings", "other_markings"),
}


def listed(case: Case, folder: Path) -> dict[str, list[NDArray[np.float64]]]:
    """Return the vertices of the lines of `label`."""
    results = folder / case.name
    mlsroad("label", case.survey, "-o", results, "--overwrite")
    found = {}
    for name, layers in KINDS_OF.items():
        parts = [geopandas.read_file(results / "inventory.gpkg", layer=layer).geometry for layer in layers]
        found[name] = [shapely.get_coordinates(line, include_z=True) for lines in parts for line in lines]
    return found


def scores_of(case: Case, lines: dict[str, list[NDArray[np.float64]]]) -> dict[str, list[LineScores]]:
    """Return the scores of a survey at each distance, by kind."""
    scores = {}
    for name in KINDS_OF:
        true: Places | None = getattr(case, name)
        if true is not None:
            found = places_along(lines[name], solid=name == "wires")
            found = found[cKDTree(true[0]).query(found)[0] <= case.near]
            scores[name] = [score_lines(found, true[0], within=d, uncounted=true[1]) for d in WITHIN]
    return scores


def mean(scores: list[LineScores]) -> LineScores:
    """Return the scores of several surveys together, weighted by length."""
    true, found = (np.array([getattr(s, name) for s in scores]) for name in ("true", "listed"))
    shares = [
        float(np.nansum([getattr(s, share) for s in scores] * total) / max(total.sum(), 1e-9))
        for share, total in (("found", true), ("right", found))
    ]
    return LineScores(float(true.sum()), float(found.sum()), *shares)


def print_row(name: str, kind: str, values: list[LineScores]) -> None:
    """Print a row of the table."""
    shares = " | ".join(f"{v.found:.2f}, {v.right:.2f}" for v in values)
    print(f"| {name} | {kind} | {values[0].true:.0f} | {values[0].listed:.0f} | {shares} |", flush=True)


def main() -> None:
    """Simulate, label, score, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--only", nargs="+", choices=list(SETS), default=list(SETS))
    arguments.add_argument("--folder", type=Path, default=RESULTS / "line_scores")
    options = arguments.parse_args()
    folder, record = options.folder.absolute(), {}
    print("| data | lines | true, m | listed, m |" + "".join(f" found, right at {d} m |" for d in WITHIN))
    print("|---|---|---|---|" + "---|" * len(WITHIN))
    for name in options.only:
        found = {}
        for case in SETS[name](folder):
            found[case.name] = scores_of(case, listed(case, folder))
            for kind, values in found[case.name].items():
                print_row(case.name, kind, values)
        for kind in KINDS_OF:
            of_kind = [scores[kind] for scores in found.values() if kind in scores]
            if of_kind:
                values = [mean(list(row)) for row in zip(*of_kind, strict=True)]
                print_row(f"**{name}**", kind, values)
                found.setdefault(name, {})[kind] = values
        if not found:
            print(f"| {name}: no data below {DATA} |")
        record |= found
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "line_scores.json").write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
