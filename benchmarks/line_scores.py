"""Scores of the kerbs and wires of `label`, with the shipped model, on simulated streets and on recordings.

    python benchmarks/line_scores.py [--only simulated semantickitti ...] [--folder FOLDER]

- simulated: streets of 100 m of four kinds (town, suburb, ring_road, campus), seen by two scanners (presets `demo`, a
  sixth of the pulses of a VMX-450, and `hdl32`), seeds that nothing was chosen on. A true kerb counts if it is at least
  5 cm high and both of its sides have points in four cells of 0.1 m within 0.35 m; lower and hidden ones are uncounted.
  A true wire reaches from its first to its last point, in space, and counts if it has 50 points and is 3 m long;
- semantickitti, pandaset: scans of SemanticKITTI 00 and frames of PandaSet 001, each labelled alone. The reference is
  the border between points of road or parking and of sidewalk, at most 0.5 m apart; borders to other ground are
  uncounted. Not every such border is a kerb.

Recordings lie below $MLSROAD_DATA. Prints a table in Markdown and writes `line_scores.json` into the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import geopandas
import laspy
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.metrics.line_scores import LineScores, places_along, score_lines
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.simulation.street.kerb_truth import true_kerbs

DATA = Path(os.environ.get("MLSROAD_DATA", "../shared/data")).absolute()
KINDS, SCANNERS = ("town", "suburb", "ring_road", "campus"), ("demo", "hdl32")
FIRST_SEED, LENGTH = 931, 100
LEAST, NEAR, CELLS = 0.05, 0.35, 4  # metres, metres, cells on either side
WITHIN = (0.1, 0.2, 0.5)


class Case(NamedTuple):
    """A survey, its true kerbs as places every 0.1 m, uncounted ones, and its true wires, None where not known."""

    name: str
    survey: Path
    true: NDArray[np.float64]
    uncounted: NDArray[np.float64]
    wires: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


def mlsroad(*arguments: object) -> None:
    """Run the command; its errors end the benchmark."""
    code = "import sys; sys.argv[0] = 'mlsroad'; from mlsroad_pipeline.commands.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"mlsroad {' '.join(map(str, arguments))}: {done.stderr.strip()}")


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
    for number, (kind, scanner) in enumerate((k, s) for k in KINDS for s in SCANNERS):
        street, seed = folder / "streets" / f"{kind}_{scanner}", FIRST_SEED + number
        if not (street / "objects.csv").is_file():
            options = ("--preset", scanner, "--seed", seed, "--length", LENGTH, "--overwrite")
            mlsroad("simulate", "-o", street, *options, "--params", f"street={kind}", "--params", "with_images=false")
        described = {"preset": scanner, "seed": seed, "length": LENGTH, "street": kind, "with_images": False}
        stream = SurveyStream(simulation_parameters(described))
        kerbs = true_kerbs(stream.street, start=-40.0, end=LENGTH + 40.0)
        kerbs[:, :3] += stream.origin
        high = kerbs[:, 3] >= LEAST
        counted = np.zeros(len(kerbs), dtype=bool)
        points = laspy.read(street / "survey.laz")
        counted[high] = seen(kerbs[high], np.asarray(points.xyz))
        yield Case(street.name, street, kerbs[counted, :2], kerbs[~counted, :2], true_wires(points))


def true_wires(points: laspy.LasData) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
        yield Case(
            f"kitti_{scan.stem}", scan, border(xyz, road, code == 48), border(xyz, road, np.isin(code, [49, 72]))
        )


def pandaset(_: Path) -> Iterator[Case]:
    """Yield the frames."""
    for frame in sorted((DATA / "real/pandaset/001/frames").glob("*.npz")):
        with np.load(frame, allow_pickle=False) as arrays:
            xyz, code = arrays["xyz"].astype(np.float64), arrays["label"]
        road = np.isin(code, [7, 8, 9, 10])
        yield Case(
            f"pandaset_{frame.stem}", frame, border(xyz, road, code == 11), border(xyz, road, np.isin(code, [5, 6, 12]))
        )


SETS = {f.__name__: f for f in (simulated, semantickitti, pandaset)}


def listed(case: Case, folder: Path) -> dict[str, list[NDArray[np.float64]]]:
    """Return the vertices of the kerbs and wires of `label`."""
    results = folder / case.name
    mlsroad("label", case.survey, "-o", results, "--overwrite")
    layers = {name: geopandas.read_file(results / "inventory.gpkg", layer=name) for name in ("kerbs", "wires")}
    return {
        name: [shapely.get_coordinates(line, include_z=True) for line in frame.geometry]
        for name, frame in layers.items()
    }


def scores_of(case: Case, lines: dict[str, list[NDArray[np.float64]]]) -> dict[str, list[LineScores]]:
    """Return the scores of a survey at each distance, by kind."""
    kerbs = places_along(lines["kerbs"])
    scores = {"kerbs": [score_lines(kerbs, case.true, within=d, uncounted=case.uncounted) for d in WITHIN]}
    if case.wires is not None:
        wires = places_along(lines["wires"], solid=True)
        scores["wires"] = [score_lines(wires, case.wires[0], within=d, uncounted=case.wires[1]) for d in WITHIN]
    return scores


def mean(scores: list[LineScores]) -> LineScores:
    """Return the scores of several surveys together, weighted by length."""
    true, found = (np.array([getattr(s, name) for s in scores]) for name in ("true", "listed"))
    shares = [
        float(np.nansum([getattr(s, share) * getattr(s, length) for s in scores]) / max(total.sum(), 1e-9))
        for share, length, total in (("found", "true", true), ("right", "listed", found))
    ]
    return LineScores(float(true.sum()), float(found.sum()), *shares)


def print_row(name: str, kind: str, values: list[LineScores]) -> None:
    """Print a row of the table."""
    shares = " | ".join(f"{v.found:.2f}, {v.right:.2f}" for v in values)
    print(f"| {name} | {kind} | {values[0].true:.0f} | {values[0].listed:.0f} | {shares} |", flush=True)


def main() -> None:
    """Simulate, label, score, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(SETS), default=list(SETS))
    parser.add_argument("--folder", type=Path, default=Path("data/08_reporting/line_scores"))
    options = parser.parse_args()
    folder = options.folder.absolute()
    record: dict[str, dict[str, list[LineScores]]] = {}
    print("| data | lines | true, m | listed, m |" + "".join(f" found, right at {d} m |" for d in WITHIN))
    print("|---|---|---|---|" + "---|" * len(WITHIN))
    for name in options.only:
        found = {}
        for case in SETS[name](folder):
            found[case.name] = scores_of(case, listed(case, folder))
            for kind, values in found[case.name].items():
                print_row(case.name, kind, values)
        for kind in ("kerbs", "wires"):
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
