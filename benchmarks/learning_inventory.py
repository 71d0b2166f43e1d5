"""Inventory of five blocks of Oakland 3-D before and after corrections of six others, with the commands of a user.

    python benchmarks/learning_inventory.py [--folder FOLDER]

Labels both parts with the shipped model, decides about the objects of the first as the reference does (trees, whose
reference is incomplete, are accepted alone), runs `mlsroad learn --no-label`, and labels the second part with the new
model: once with decisions about listed objects, once with missing poles, signs and vehicles added too. Blocks lie in
$MLSROAD_DATA/oakland. Prints F by kind at the default score; vehicles within 2 m.
"""

from __future__ import annotations

import shutil
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

import geopandas
import numpy as np
import pandas as pd
from _common import DATA, RESULTS, mlsroad, parser
from inventory_scores import TEXT

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.review.corrections import Correction, open_corrections

FIRST = ("part2_ac", "part2_ad", "part2_ae", "part2_ag", "part2_ah", "part2_ai")
"""Blocks whose objects are corrected; the others are scored."""
REACH = {"pole": 0.5, "sign": 0.5, "vehicle": 2.0}
"""Distances of a pair in metres: the reference of a vehicle is the mean of its seen side."""
OPTIONS = [option for pair in TEXT for option in ("--params", pair)]


def objects_of(folder: Path) -> pd.DataFrame:
    """Return the objects of an inventory."""
    return geopandas.read_file(folder / "inventory.gpkg", layer="objects")


def pairs(objects: pd.DataFrame, truth: pd.DataFrame, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of listed and of true objects of a kind that are one, as positions in both tables."""
    own, true = (np.flatnonzero(table["kind"] == kind) for table in (objects, truth))
    places = (table[["x", "y"]].to_numpy()[rows] for table, rows in ((objects, own), (truth, true)))
    a, b = assign_one_to_one(*places, REACH.get(kind, 1.0))
    return own[a], true[b]


def decide(folder: Path, truth: pd.DataFrame, *, add: bool) -> list[int]:
    """Write the decisions of a user who knows the reference; return how many accept, change, reject and add."""
    objects, found, counts = objects_of(folder), np.zeros(len(truth), bool), [0, 0, 0, 0]
    with open_corrections(folder) as store:

        def decided(which: int, correction: Correction) -> None:
            store.add(correction, who="reference")
            counts[which] += 1

        for kind in (*REACH, "tree"):
            right, true = pairs(objects, truth, kind)
            found[true] = True
            for row in np.flatnonzero(objects["kind"] == kind):
                number, place = int(objects["object_id"].iloc[row]), objects.iloc[row]
                if row in right:
                    decided(0, Correction("accept", number))
                    continue
                if kind == "tree":
                    continue
                others = truth[truth["kind"] != kind]
                gap = np.hypot(others["x"] - place["x"], others["y"] - place["y"])
                near = others.loc[gap.idxmin()]
                if gap.min() <= REACH.get(near["kind"], 1.0):
                    decided(1, Correction("other_kind", number, kind=near["kind"]))
                else:
                    decided(2, Correction("reject", number))
        missing = truth[~found & truth["kind"].isin(list(REACH))]
        for one in missing.to_dict("records") if add else []:
            payload = {axis: float(one[axis]) for axis in "xyz"}
            decided(3, Correction("add", kind=one["kind"], payload=payload))
    return counts


def scores(folder: Path, truth: pd.DataFrame) -> str:
    """Return F by kind and the mean, as cells of a table."""
    objects, values = objects_of(folder), []
    for kind in REACH:
        listed, true = ((table["kind"] == kind).sum() for table in (objects, truth))
        values.append(2 * len(pairs(objects, truth, kind)[0]) / (listed + true))
    return " | ".join(f"{value:.2f}" for value in [*values, np.mean(values)])


def main() -> None:
    """Label, decide, learn, label again, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "learning_inventory")
    folder = arguments.parse_args().folder.absolute()
    blocks, truth = sorted((DATA / "oakland").glob("*.xyz_label_conf.gz")), pd.read_csv(DATA / "oakland/objects.csv")
    first = [path for path in blocks if path.name.removeprefix("oakland_").startswith(FIRST)]
    second = [path for path in blocks if path not in first]
    of_first = truth["blocks"].str.contains("|".join(FIRST))
    folder.mkdir(parents=True, exist_ok=True)
    mlsroad("label", *first, "-o", folder / "first", "--overwrite", *OPTIONS)
    mlsroad("label", *second, "-o", folder / "second", "--overwrite", *OPTIONS)
    print("| decisions: accepted, changed, rejected, added | poles | signs | vehicles | mean |\n|---|---|---|---|---|")
    print(f"| none | {scores(folder / 'second', truth[~of_first])} |", flush=True)
    for add in (False, True):
        corrected = folder / ("first_added" if add else "first_decided")
        shutil.rmtree(corrected, ignore_errors=True)
        shutil.copytree(folder / "first", corrected)
        counts = decide(corrected, truth[of_first].reset_index(drop=True), add=add)
        with TemporaryDirectory() as place, chdir(place):  # no project, whose registry would get the model
            mlsroad("learn", corrected, "--no-label")
        (model,) = (corrected / "models").iterdir()
        again = folder / ("second_added" if add else "second_decided")
        mlsroad("label", *second, "-o", again, "--overwrite", "--model", model, *OPTIONS)
        print(f"| {', '.join(map(str, counts))} | {scores(again, truth[~of_first])} |", flush=True)


if __name__ == "__main__":
    main()
