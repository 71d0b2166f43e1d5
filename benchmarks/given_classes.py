"""Inventories of surveys that are classified already, beside those of the shipped model.

    python benchmarks/given_classes.py [--only simulated oakland ...] [--folder FOLDER]

Each survey is labelled twice, by `mlsroad label` and with its true classes kept (`--keep-classes`). Both inventories
are scored as `mlsroad score` does (docs/scoring.md):

- simulated: eight streets of 80 m (preset `small`), whose files have the LAS codes of the true classes;
- oakland, pandaset, semantickitti: the recordings of `inventory_scores.py`, with the codings of their labels.

Recordings lie below $MLSROAD_DATA. Prints a table in Markdown and writes `given_classes.json` into the folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from shutil import copy

import laspy
import numpy as np
import pandas as pd
from _common import RESULTS, configured_scheme, markdown, mlsroad, parser
from inventory_scores import SETS, TEXT, Case, joined
from register_states import SEEDS, street_of

from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import score_objects
from mlsroad_pipeline.label.object_scoring import ScoreParameters, score_inventory

LABELLED_TEXT = ("label.read.columns={x: 0, y: 1, z: 2, label: 3}", *TEXT[1:])
MAPS = {"simulated": "mlsroad", "oakland": "oakland", "pandaset": "pandaset", "semantickitti": "semantickitti"}
LISTED = 0.4
"""Least score of a listed object, as `label` has it by default."""


def classified(folder: Path) -> Iterator[Case]:
    """Yield streets whose files have the LAS codes of their true classes."""
    scheme = configured_scheme("road_inventory")
    for seed in SEEDS:
        street, place = street_of(folder, seed), folder / f"classified_{seed}"
        place.mkdir(parents=True, exist_ok=True)
        las = laspy.read(street / "survey.laz")
        label = scheme.encode(np.asarray(las["label"]))
        las.classification = np.where(label < 0, 1, scheme.codes()[label])
        las.write(place / "survey.laz")
        copy(street / "trajectory.csv", place)
        yield Case(place.name, [place], street)


def labelled_scans(folder: Path) -> Iterator[Case]:
    """Yield the scans of SemanticKITTI with their labels beside them."""
    for case in SETS["semantickitti"](folder):
        place = folder / f"{case.name}_scan"
        place.mkdir(parents=True, exist_ok=True)
        copy(case.files[0], place / "000000.bin")
        copy(case.truth, place / "000000.label")
        yield case._replace(files=[place])


OWN = {"simulated": classified, "semantickitti": labelled_scans}
"""Data sets whose files are made."""


def scores_of(name: str, case: Case, folder: Path, *, given: bool) -> object:
    """Return the scored inventory of a survey."""
    results = folder / f"{case.name}_{'given' if given else 'label'}"
    params = LABELLED_TEXT if given and case.params else case.params
    options = [option for pair in params for option in ("--params", pair)]
    options += ["--keep-classes", "--class-map", MAPS[name]] if given else []
    mlsroad("label", *case.files, "-o", results, "--overwrite", *options)
    known = {"recall_only": case.recall_only, "least_score": LISTED, "reach": case.reach}
    return score_inventory(ScoreParameters(str(results), str(case.truth), **known))


def main() -> None:
    """Label, score, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--only", nargs="+", choices=list(MAPS), default=list(MAPS))
    arguments.add_argument("--folder", type=Path, default=RESULTS / "given_classes")
    options = arguments.parse_args()
    folder = options.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in options.only:
        cases = list(OWN.get(name, SETS[name])(folder))
        partial = sorted({kind for case in cases for kind in case.recall_only})
        for given in (False, True):
            parts = [scores_of(name, case, folder, given=given) for case in cases]
            table = score_objects(joined(parts), recall_only=partial)
            rows += [
                {"data": name, "classes": "given" if given else "model", **row} for row in table.to_dict("records")
            ]
    found = pd.DataFrame(rows)
    print(markdown(found.round(2)))
    (folder / "given_classes.json").write_text(json.dumps(found.to_dict("records"), indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
