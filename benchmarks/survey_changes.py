"""Changes between two surveys of simulated streets, by `mlsroad compare`, against what the simulator changed.

    python benchmarks/survey_changes.py [--streets 81 82 ...] [--folder FOLDER]

Four streets of 80 m (preset `small`) are simulated three times: as they are, in another year by another scanner and
with an offset, and as they are in another pass. Each is labelled by the shipped model, and listed from its true
classes. True objects count where their survey has the points that an object of the inventory needs; an object is new
or gone where the simulator built it in one of the years alone. Places agree within 1 m.

Prints tables in Markdown and writes `survey_changes.json` into the folder.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from shutil import copy

import laspy
import numpy as np
import pandas as pd
from _common import RESULTS, configured_scheme, markdown, mlsroad, parser
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.changes import objects as states
from mlsroad_pipeline.algorithms.inventory.register.states import REACH
from mlsroad_pipeline.simulation import PRESETS, SimulationParameters, another_year
from mlsroad_pipeline.simulation.furnishing.blocks import populate
from mlsroad_pipeline.simulation.parameters.street_parameters import street_parameters
from mlsroad_pipeline.simulation.street.street import draw_street
from mlsroad_pipeline.surveys.simulated import write_simulated_survey
from mlsroad_pipeline.surveys.truth_tables import counted_objects, point_counts, read_truth

SEEDS = dict(zip(range(81, 85), ("town", "suburb", "campus", "ring_road"), strict=True))
OFFSET = (0.05, -0.04, 0.03)
WITHIN = 1.0
FALSE = (states.CHANGED, states.MOVED, states.NEW, states.GONE, states.OTHER_KIND)  # between two passes


def surveys_of(seed: int, kind: str) -> dict[str, SimulationParameters]:
    """Return the three surveys of a street."""
    street = street_parameters({"kind": kind, "signs": 3.0, "lamp_spacing": 12.0})
    first = replace(PRESETS["small"], seed=seed, with_images=False, street=street)
    later = another_year(
        first, 1, offset=OFFSET, scanner=PRESETS["vmq1ha"].scanner, pulse_rate=130_000.0, profile_rate=100.0
    )
    return {"first": first, "later": later, "again": replace(first, first_pass=2)}


def results_of(folder: Path, name: str, parameters: SimulationParameters, *, given: bool) -> tuple[Path, Path]:
    """Return the folders of a survey and of its results, made unless they are there."""
    street, scheme = folder / name, configured_scheme("road_inventory")
    if not (street / "objects.csv").is_file():
        write_simulated_survey(parameters=parameters, folder=str(street), n_threads=2)
    if not given:
        mlsroad("label", street)
        return street, folder / f"{name}_mlsroad"
    place = folder / f"{name}_true"
    if not (place / "survey.laz").is_file():
        place.mkdir(exist_ok=True)
        las = laspy.read(street / "survey.laz")
        label = scheme.encode(np.asarray(las["label"]))
        las.classification = np.where(label < 0, 1, scheme.codes()[label])
        las.write(place / "survey.laz")
        copy(street / "trajectory.csv", place)
    mlsroad("inventory", place, "--class-map", "mlsroad")
    return street, folder / f"{name}_true_mlsroad"


def objects_of(street: Path, parameters: SimulationParameters) -> tuple[pd.DataFrame, set[int]]:
    """Return the true poles, signs and trees by instance that count, and the instances that were built."""
    truth = read_truth(street)
    table = truth.objects.assign(points=point_counts(truth, [street / "survey.laz"]))
    table = counted_objects(truth._replace(objects=table), table["points"], {})
    drawn = draw_street(parameters.seed, length=parameters.length, parameters=parameters.street)
    built = {p.instance for block in range(-2, 4) for p in populate(drawn, block)}
    return table[table["counted"] & table["kind"].isin(REACH)].set_index("instance"), built


def axis_of(table: pd.DataFrame) -> np.ndarray:
    """Return the axes of true objects."""
    tilt, way = (np.radians(table[name].to_numpy(float)) for name in ("tilt", "lean_azimuth"))
    return np.column_stack([np.sin(tilt) * np.sin(way), np.sin(tilt) * np.cos(way), np.cos(tilt)])


def found_at(rows: pd.DataFrame, true: pd.DataFrame) -> tuple[int, int]:
    """Return the number of rows, and the number of true objects with one of their kind within `WITHIN`."""
    hits = 0
    for kind, part in true.groupby("kind"):
        own = rows[rows["kind"] == kind][["x", "y"]].to_numpy(float)
        hits += int((cKDTree(own).query(part[["x", "y"]])[0] < WITHIN).sum()) if len(own) else 0
    return len(rows), hits


def scored(table: pd.DataFrame, before: pd.DataFrame, after: pd.DataFrame, built: tuple[set[int], set[int]]) -> dict:
    """Return counts of true, listed and right changes of a pair of surveys."""
    both = before.index.intersection(after.index)
    way = np.hypot(*(after.loc[both, ["x", "y"]] - before.loc[both, ["x", "y"]] - list(OFFSET[:2])).to_numpy(float).T)
    parts = {
        states.NEW: after[~after.index.isin(built[0])],
        states.GONE: before[~before.index.isin(built[1])],
        states.MOVED: after.loc[both[way > WITHIN]],
    }
    counts = {state: (len(part), *found_at(table[table["state"] == state], part)) for state, part in parts.items()}
    poles = both[(before.loc[both, "kind"] == "pole") & (way <= WITHIN)]
    turn = np.degrees(np.arccos((axis_of(before.loc[poles]) * axis_of(after.loc[poles])).sum(axis=1).clip(-1, 1)))
    own = table[table["kind"].eq("pole") & table["tilt_change"].notna()]
    near, row = cKDTree(own[["x", "y"]]).query(after.loc[poles, ["x", "y"]])
    told, listed = own["changes"].str.contains("tilt").to_numpy()[row], near < WITHIN
    for name, low, high in (("1 degree", 0.75, 1.5), ("2 degrees", 1.5, 10.0)):
        inside = listed & (turn >= low) & (turn < high)
        counts[f"tilt of {name}"] = (int(inside.sum()), *2 * (int((told & inside).sum()),))
    return counts


def main() -> None:
    """Simulate, label, compare, print."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "survey_changes")
    arguments.add_argument("--streets", nargs="+", type=int, choices=list(SEEDS), default=list(SEEDS))
    options = arguments.parse_args()
    folder = options.folder.absolute()
    rows = []
    for labels in ("model", "true"):
        for seed in options.streets:
            made = {
                n: (p, *results_of(folder, f"{seed}_{n}", p, given=labels == "true"))
                for n, p in surveys_of(seed, SEEDS[seed]).items()
            }
            truth = {name: objects_of(street, parameters) for name, (parameters, street, _) in made.items()}
            for later in ("later", "again"):
                out = folder / f"{seed}_{later}_{labels}_changes"
                mlsroad("compare", made["first"][2], made[later][2], "-o", out, "--overwrite", "--no-surfaces")
                table = pd.read_csv(out / "changes.csv")
                table["changes"] = table["changes"].astype(object).fillna("")
                wrong = int(table["state"].isin(FALSE).sum())
                counts = {"false between passes": (len(table), wrong, 0)}
                if later == "later":
                    counts = scored(table, truth["first"][0], truth[later][0], (truth["first"][1], truth[later][1]))
                rows += [(labels, seed, name, *numbers) for name, numbers in counts.items()]
    table = pd.DataFrame(rows, columns=["labels", "seed", "change", "true", "listed", "right"])
    summed = table.groupby(["labels", "change"], sort=False)[["true", "listed", "right"]].sum().reset_index()
    summed["F"] = (2 * summed["right"] / (summed["true"] + summed["listed"])).round(3)
    print(markdown(summed))
    (folder / "survey_changes.json").write_text(json.dumps(summed.to_dict("records"), indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
