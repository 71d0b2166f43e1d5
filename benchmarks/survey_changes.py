"""Changes between two surveys of simulated streets, by `mlsroad compare`, against what the simulator changed.

    python benchmarks/survey_changes.py [--folder FOLDER]

Four streets of 80 m (preset `small`) are simulated three times: as they are, in another year by another scanner and
with an offset, and as they are in another pass. Each is labelled by the shipped model, and listed from its true
classes. True objects count where their survey has the points that an object of the inventory needs, and the other one
15 points of the ground within 0.4 m of their place. An object is new or gone where the simulator built it in one of the
years alone. Places agree within 1 m; listed changes of objects that do not count are left out.

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
from scipy.spatial.distance import cdist

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
Survey = tuple[SimulationParameters, Path, Path]  # with its folder and that of its results
FALSE = (states.CHANGED, states.MOVED, states.NEW, states.GONE, states.OTHER_KIND)  # between two passes


def surveys_of(seed: int, kind: str) -> dict[str, SimulationParameters]:
    """Return the three surveys of a street."""
    street = street_parameters({"kind": kind, "signs": 3.0, "lamp_spacing": 12.0})
    first = replace(PRESETS["small"], seed=seed, with_images=False, street=street)
    scanner = {"scanner": PRESETS["vmq1ha"].scanner, "pulse_rate": 130_000.0, "profile_rate": 100.0}
    later = another_year(first, 1, offset=OFFSET, **scanner)
    return {"first": first, "later": later, "again": replace(first, first_pass=2)}


def results_of(folder: Path, name: str, parameters: SimulationParameters, *, given: bool) -> Survey:
    """Return a survey, made unless it is there."""
    street, scheme = folder / name, configured_scheme("road_inventory")
    if not (street / "objects.csv").is_file():
        write_simulated_survey(parameters=parameters, folder=str(street), n_threads=2)
    place = street if not given else folder / f"{name}_true"
    results = folder / f"{place.name}_mlsroad"
    if given and not (place / "survey.laz").is_file():
        place.mkdir(exist_ok=True)
        las = laspy.read(street / "survey.laz")
        label = scheme.encode(np.asarray(las["label"]))
        las.classification = np.where(label < 0, 1, scheme.codes()[label])
        las.write(place / "survey.laz")
        copy(street / "trajectory.csv", place)
    if not (results / "inventory.gpkg").is_file():
        mlsroad(*(("inventory", place, "--class-map", "mlsroad") if given else ("label", place)))
    return parameters, street, results


def objects_of(own: Survey, other: Survey) -> pd.DataFrame:
    """Return the true poles, signs and trees of a survey by instance and kind: a plate on a lamp has its instance.

    Those of `counted` have enough points, and the other survey has seen their place; it has none of those of `alone`.
    """
    truth, (parameters, seen, _) = read_truth(own[1]), other
    table = counted_objects(truth, point_counts(truth, [own[1] / "survey.laz"]), {})
    las = laspy.read(seen / "survey.laz")
    ground = cKDTree(np.asarray(las.xyz)[(las["label"] >= 1) & (las["label"] <= 10), :2])
    table["counted"] &= ground.query_ball_point(table[["x", "y"]].to_numpy(), 0.4, return_length=True) >= 15
    drawn = draw_street(parameters.seed, length=parameters.length, parameters=parameters.street)
    built = {placed.instance for block in range(-2, 4) for placed in populate(drawn, block)}
    table = table.assign(alone=~table["instance"].isin(built))[table["kind"].isin(REACH)]
    return table.set_index(["instance", "kind"], drop=False).rename_axis([None, None])


def axis_of(table: pd.DataFrame) -> np.ndarray:
    """Return the axes of true objects."""
    tilt, way = (np.radians(table[name].to_numpy(float)) for name in ("tilt", "lean_azimuth"))
    return np.column_stack([np.sin(tilt) * np.sin(way), np.sin(tilt) * np.cos(way), np.cos(tilt)])


def found_at(rows: pd.DataFrame, true: pd.DataFrame) -> tuple[int, int, int]:
    """Return the number of true objects that count, of rows, and of such objects with a row within `WITHIN`."""
    hits, left_out = 0, 0
    for kind, part in true.groupby("kind"):
        near = cdist(part[["x", "y"]], rows[rows["kind"] == kind][["x", "y"]]) < WITHIN
        hits += int(near[part["counted"]].any(axis=1).sum())
        left_out += int((near.any(axis=0) & ~near[part["counted"]].any(axis=0)).sum())
    return int(true["counted"].sum()), len(rows) - left_out, hits


def scored(table: pd.DataFrame, before: pd.DataFrame, after: pd.DataFrame) -> dict:
    """Return counts of true, listed and right changes of a pair of surveys."""
    both = before.index.intersection(after.index)
    way = np.hypot(*(after.loc[both, ["x", "y"]] - before.loc[both, ["x", "y"]] - list(OFFSET[:2])).to_numpy(float).T)
    moved = after.loc[both[way > WITHIN]]
    moved = moved.assign(counted=moved["counted"] & before["counted"])
    # One that moved from or to a place that was not seen may be new or gone.
    half = moved.index[~moved["counted"]]
    new = pd.concat([after[after["alone"]], moved.loc[half]])
    gone = pd.concat([before[before["alone"]], before.loc[half].assign(counted=False)])
    parts = {states.NEW: new, states.GONE: gone, states.MOVED: moved}
    counts = {state: found_at(table[table["state"] == state], true) for state, true in parts.items()}
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
    folder = arguments.parse_args().folder.absolute()
    rows = []
    for labels in ("model", "true"):
        for seed, kind in SEEDS.items():
            surveys = surveys_of(seed, kind)
            made = {n: results_of(folder, f"{seed}_{n}", p, given=labels == "true") for n, p in surveys.items()}
            for later in ("later", "again"):
                out, ends = folder / f"{seed}_{later}_{labels}_changes", (made["first"], made[later])
                mlsroad("compare", *(results for _, _, results in ends), "-o", out, "--overwrite", "--no-surfaces")
                table = pd.read_csv(out / "changes.csv", converters={"changes": str})
                wrong = int(table["state"].isin(FALSE).sum())
                false = {"false between passes": (len(table), wrong, 0)}
                counts = false if later == "again" else scored(table, objects_of(*ends), objects_of(*ends[::-1]))
                rows += [(labels, seed, name, *numbers) for name, numbers in counts.items()]
    table = pd.DataFrame(rows, columns=["labels", "seed", "change", "true", "listed", "right"])
    summed = table.groupby(["labels", "change"], sort=False)[["true", "listed", "right"]].sum().reset_index()
    summed["F"] = (2 * summed["right"] / (summed["true"] + summed["listed"])).round(3)
    print(markdown(summed))
    (folder / "survey_changes.json").write_text(json.dumps(summed.to_dict("records"), indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
