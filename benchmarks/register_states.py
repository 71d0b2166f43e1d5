"""States of registers with planted errors on simulated streets, by `mlsroad compare`.

    python benchmarks/register_states.py [--folder FOLDER]

Eight streets of 80 m (preset `small`) are simulated and labelled. Each has a register: its true poles, signs and trees
with an error of 0.15 m and a common offset of (0.8, -0.6) m. Of these 5 % are left out, 5 % are moved by 2 to 4 m and
5 % have another kind (two at least). Entries that do not exist are added, at least 6 m from any true one: `not found`
is expected where 15 points of the ground lie within 0.4 m and nothing upright within 0.8 m, `not visible` where no
ground lies within 2 m. Entries whose object has too few points near its place (20, signs 10, within 0.8 m and up to
5.3 m above the base) should be confirmed or not visible.

Prints tables in Markdown and writes `register_states.json` into the folder.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import laspy
import numpy as np
import pandas as pd
from _common import RESULTS, markdown, mlsroad, parser
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.register.states import STATES
from mlsroad_pipeline.label.register import compare_register
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.surveys.register_files import RegisterFile
from mlsroad_pipeline.surveys.truth_tables import counted_objects, point_counts, read_truth

CONFIRMED, MOVED, OTHER_KIND, NOT_FOUND, NOT_VISIBLE, NEW = STATES
SEEDS = range(51, 59)
SHIFT, NOISE, SHARE = np.array([0.8, -0.6]), 0.15, 0.05
LEAST = {"pole": 20, "sign": 10, "tree": 20}
UNSEEN = "confirmed or not visible"
KINDS = ("pole", "sign", "tree")


class Street(NamedTuple):
    """True objects of a street (`near`: points near the place), points with taxonomy codes, and the path."""

    truth: pd.DataFrame
    xyz: NDArray[np.float64]
    code: NDArray[np.uint8]
    path: NDArray[np.float64]


def street_of(folder: Path, seed: int) -> Path:
    """Return the folder of a street, simulated unless it is there."""
    street = folder / f"t{seed}"
    if not (street / "objects.csv").is_file():
        changes = ("street.signs=3", "street.people=2", "with_images=false")
        options = [word for change in changes for word in ("--params", change)]
        mlsroad("simulate", "-o", street, "--length", 80, "--seed", seed, "--overwrite", *options)
    return street


def read_street(street: Path, clouds: list[Path]) -> Street:
    """Return what is true of a street."""
    truth = read_truth(street)
    table = truth.objects.assign(points=point_counts(truth, clouds))
    listed = table["kind"].isin(KINDS) & table["counted"]
    table = counted_objects(truth._replace(objects=table), table["points"], {})[listed].reset_index(drop=True)
    las = laspy.read(clouds[0])
    xyz, instance = np.asarray(las.xyz), np.asarray(las["instance"])
    near = []
    for row in table.to_dict("records"):
        own = xyz[instance == row["instance"]] - [row["x"], row["y"], row["z"]]
        near.append(int(((np.hypot(*own.T[:2]) < 0.8) & (own[:, 2] > 0.3) & (own[:, 2] < 5.3)).sum()))
    path = pd.read_csv(street / "trajectory.csv")[["x", "y"]].to_numpy()
    return Street(table.assign(near=near), xyz, np.asarray(las["label"]), path)


def planted_errors(street: Street, rng: np.random.Generator) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the entries of true objects with the state that is expected, and the objects that are left out."""
    truth = street.truth
    seen = truth["counted"] & (truth["near"] >= truth["kind"].map(LEAST))
    count = max(2, round(SHARE * len(truth)))
    out, moved, wrong = np.split(rng.permutation(len(truth))[: 3 * count], 3)
    entries = truth[["kind", "x", "y", "height"]].assign(id=truth["instance"], expected=CONFIRMED)
    turn, far = rng.random(count) * 2 * np.pi, rng.uniform(2, 4, count)
    entries.loc[moved, "x"] += far * np.cos(turn)
    entries.loc[moved, "y"] += far * np.sin(turn)
    entries.loc[moved, "expected"] = MOVED
    others = [[other for other in KINDS if other != kind] for kind in entries.loc[wrong, "kind"]]
    entries.loc[wrong, "kind"] = [str(rng.choice(names)) for names in others]
    entries.loc[wrong, "expected"] = OTHER_KIND
    entries.loc[~seen, "expected"] = UNSEEN
    return entries.drop(index=out), truth.loc[out][seen[out]]


def absent_entries(street: Street, count: int, rng: np.random.Generator) -> pd.DataFrame:
    """Return entries of objects that do not exist, at places that are clearly seen or clearly unseen."""
    is_ground = (street.code >= 1) & (street.code <= 10)
    ground = cKDTree(street.xyz[is_ground, :2])
    upright = cKDTree(street.xyz[(street.code >= 20) & (street.code < 90), :2])
    true = cKDTree(street.truth[["x", "y"]].to_numpy())
    rows: list[tuple[object, ...]] = []
    while len(rows) < count:
        turn, far = rng.random() * 2 * np.pi, rng.uniform(3, 20)
        place = street.path[rng.integers(len(street.path))] + far * np.array([np.cos(turn), np.sin(turn)])
        if true.query(place)[0] < 6:
            continue
        if len(ground.query_ball_point(place, 0.4)) >= 15 and upright.query(place)[0] > 0.8:
            state = NOT_FOUND
        elif ground.query(place)[0] > 2.0:
            state = NOT_VISIBLE
        else:
            continue
        rows.append((str(rng.choice(KINDS)), *place, rng.uniform(2.5, 6), 100_000 + len(rows), state))
    return pd.DataFrame(rows, columns=["kind", "x", "y", "height", "id", "expected"])


def compared(folder: Path, seed: int) -> tuple[pd.DataFrame, int, int]:
    """Return the entries of a street with their states, and how many left-out objects are new, of how many."""
    place, results = street_of(folder, seed), folder / f"t{seed}_mlsroad"
    if not (results / "inventory.gpkg").is_file():
        mlsroad("label", place, "-o", results)
    output = LabelledOutput.at(results)
    street, rng = read_street(place, list(output.clouds().values())), np.random.default_rng(seed)
    entries, out = planted_errors(street, rng)
    absent = absent_entries(street, 4 * max(2, round(SHARE * len(street.truth))), rng)
    register = pd.concat([entries, absent], ignore_index=True)
    places = register[["x", "y"]] + rng.normal(0, NOISE, (len(register), 2)) - SHIFT
    path = folder / f"register_{seed}.csv"
    register.assign(x=places["x"], y=places["y"]).drop(columns="expected").to_csv(path, index=False)
    found = compare_register(RegisterFile(path), output)
    print(f"{seed}: offset {found.offset.shift.round(2)} from {found.offset.pairs} pairs")
    new = found.table[found.table["state"] == NEW][["x", "y"]].to_numpy(dtype=np.float64)
    near = cKDTree(new).query(out[["x", "y"]].to_numpy())[0] < 1.0 if len(new) and len(out) else np.zeros(len(out))
    return found.table.iloc[: len(register)].assign(expected=register["expected"]), int(np.sum(near)), len(out)


def main() -> None:
    """Simulate, label, compare, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "register_states")
    folder = arguments.parse_args().folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    tables, new, out = zip(*(compared(folder, seed) for seed in SEEDS), strict=True)
    table = pd.concat(tables, ignore_index=True)
    unseen = (table["expected"] == UNSEEN) & table["state"].isin((CONFIRMED, NOT_VISIBLE))
    table["right"] = (table["state"] == table["expected"]) | unseen
    parts = [("state expected", "expected"), ("kind", "kind")]
    rows = [
        {"entries by": title, "": str(name), "entries": len(part), "right": round(float(part["right"].mean()), 3)}
        for title, column in parts
        for name, part in table.groupby(column, sort=True)
    ]
    absent = table[table["expected"].isin((NOT_FOUND, NOT_VISIBLE))]
    rows += [{"entries by": "absent", "": "", "entries": len(absent), "right": round(float(absent["right"].mean()), 3)}]
    print(markdown(pd.DataFrame(rows)))
    print(markdown(pd.crosstab(table["expected"], table["state"]).reset_index()))
    print(f"Objects that the registers leave out and that are new: {sum(new)} of {sum(out)}")
    record = {"rows": rows, "new": sum(new), "left out": sum(out)}
    (folder / "register_states.json").write_text(json.dumps(record, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
