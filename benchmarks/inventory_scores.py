"""Scores of the inventory of `label`, with the shipped model, on simulated streets and on recordings.

    python benchmarks/inventory_scores.py [--only simulated oakland ...] [--folder FOLDER] [--least-score 0.0]

Labels each survey with `mlsroad label` and scores its inventory as `mlsroad score` does (docs/scoring.md):

- simulated: streets of 100 m of four kinds (town, suburb, ring_road, campus), seen by two scanners (presets `demo`, a
  sixth of the pulses of a VMX-450, and `hdl32`), seeds that no model was trained on;
- oakland: the eleven blocks of Oakland 3-D as one survey, reference oakland/objects.csv; trees count recall alone. Its
  centres of vehicles are means of the points of the seen side: the boxes of vehicles cut out by their true labels lie
  within 1 m of them for 42 of 60 and within 2 m for 58, so vehicles are matched within 2 m;
- pandaset: the frames of PandaSet 001 one by one, boxes of vehicles (the shipped model learns from their points);
- semantickitti: scans of sequence 00, instances of vehicles;
- kitti: scans of KITTI objects, boxes of vehicles in the view of the camera.

Recordings lie below $MLSROAD_DATA. Streets are simulated once and kept in the folder. Prints a table per data set in
Markdown, and writes `inventory_scores.json`; every survey keeps its results and its page of scores in the folder.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import DATA, PANDASET, RESULTS, STREETS, markdown, mlsroad, parser, simulated_street

from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import (
    MatchedObjects,
    score_objects,
    summarise_measures,
)
from mlsroad_pipeline.label.object_scoring import ScoredInventory, ScoreParameters, score_inventory
from mlsroad_pipeline.review.delivery.protocol import wilson

FIRST_SEED = 911
TEXT = ("label.read.columns={x: 0, y: 1, z: 2}", "label.read.delimiter=whitespace", "label.read.header=false")


class Case(NamedTuple):
    """A survey with its truth: name, files, true objects, changed parameters, kinds with recall alone, distances."""

    name: str
    files: list[Path]
    truth: Path
    params: tuple[str, ...] = ()
    recall_only: tuple[str, ...] = ()
    reach: Mapping[str, float] = MappingProxyType({})


def simulated(folder: Path) -> Iterator[Case]:
    """Yield the streets, simulated where they are not there."""
    for number, (kind, scanner) in enumerate(STREETS):
        street = simulated_street(folder, kind, scanner, FIRST_SEED + number)
        yield Case(street.name, [street], street)


def oakland(folder: Path) -> Iterator[Case]:
    """Yield the blocks as one survey; arms, pieces and stumps of poles are no objects."""
    blocks = sorted((DATA / "oakland").glob("*.xyz_label_conf.gz"))
    objects, truth = pd.read_csv(DATA / "oakland/objects.csv"), folder / "oakland_objects.csv"
    objects[objects["kind"] != "pole_part"].to_csv(truth, index=False)
    yield Case("oakland", blocks, truth, TEXT, ("tree",), {"vehicle": 2.0})


def pandaset(_: Path) -> Iterator[Case]:
    """Yield the frames."""
    for frame in sorted(PANDASET.glob("*.npz")):
        yield Case(f"pandaset_{frame.stem}", [frame], frame.with_name(f"{frame.stem}_cuboids.csv"))


def semantickitti(_: Path) -> Iterator[Case]:
    """Yield scans."""
    for labels in (DATA / "real/semantickitti_more/makeonebug/label/000000.label", DATA / "semantickitti/000000.label"):
        beside = labels.with_suffix(".bin")
        scan = beside if beside.is_file() else labels.parents[1] / "pcd" / beside.name
        yield Case(f"semantickitti_{labels.parents[1].name}", [scan], labels)


def kitti(_: Path) -> Iterator[Case]:
    """Yield scans."""
    for labels in sorted((DATA / "real/kitti_object/training/label_2").glob("*.txt")):
        yield Case(f"kitti_{labels.stem}", [labels.parents[1] / "velodyne" / f"{labels.stem}.bin"], labels)


SETS = {f.__name__: f for f in (simulated, oakland, pandaset, semantickitti, kitti)}


def scored(case: Case, folder: Path, least_score: float) -> tuple[ScoredInventory, float]:
    """Label a survey, write the page of its scores, and return them with the seconds that labelling took."""
    results = folder / case.name
    begin = time.perf_counter()
    options = [option for pair in case.params for option in ("--params", pair)]
    mlsroad("label", *case.files, "-o", results, "--overwrite", *options)
    seconds = time.perf_counter() - begin
    partial = [option for kind in case.recall_only for option in ("--recall-only", kind)]
    partial += [option for kind, far in case.reach.items() for option in ("--params", f"score.reach.{kind}={far}")]
    mlsroad("score", results, "--truth", case.truth, "--least-score", least_score, "--overwrite", *partial)
    known = {"recall_only": case.recall_only, "least_score": least_score, "reach": case.reach}
    return score_inventory(ScoreParameters(str(results), str(case.truth), **known)), seconds


def _interval(share: float, size: float) -> str:
    found = wilson(share, size)
    return "" if np.isnan(share) else f"{found.low:.2f}–{found.high:.2f}"


def joined(parts: list[ScoredInventory]) -> MatchedObjects:
    """Return the outcomes of several surveys together."""
    objects, truth = ([getattr(part.matched, name) for part in parts] for name in ("objects", "truth"))
    return MatchedObjects(pd.concat(objects, ignore_index=True), pd.concat(truth, ignore_index=True))


def main() -> None:
    """Simulate, label, score, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--only", nargs="+", choices=list(SETS), default=list(SETS))
    arguments.add_argument("--folder", type=Path, default=RESULTS / "inventory_scores")
    arguments.add_argument("--least-score", type=float, default=0.0)
    options = arguments.parse_args()
    folder, record = options.folder.absolute(), {}
    for name in options.only:
        found = {case.name: (scored(case, folder, options.least_score), case) for case in SETS[name](folder)}
        if not found:
            print(f"\n{name}: no data below {DATA}")
            continue
        parts = [part for (part, _), _ in found.values()]
        partial = sorted({kind for _, case in found.values() for kind in case.recall_only})
        table = score_objects(joined(parts), recall_only=partial)
        for share, size in (("precision", table["right"] + table["false"]), ("recall", table["true"])):
            table[f"interval of {share}"] = [_interval(*pair) for pair in zip(table[share], size, strict=True)]
        measures = summarise_measures(pd.concat([part.errors for part in parts], ignore_index=True))
        print(f"\n{name}: {', '.join(f'{key} ({seconds:.0f} s)' for key, ((_, seconds), _) in found.items())}\n")
        print(markdown(table.round(2)), "\n")
        if name == "oakland":  # its elevations and heights are those of clusters of points, not of objects
            measures = measures[measures["measure"] == "position"]
        print(markdown(measures.drop(columns="bias").round(2)), flush=True)
        record[name] = {"scores": table.to_dict("records"), "measures": measures.to_dict("records")}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "inventory_scores.json").write_text(json.dumps(record, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
