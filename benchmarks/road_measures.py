"""Errors of the measures of `mlsroad road` on simulated streets, against the street as it was drawn.

    python benchmarks/road_measures.py [--only town_demo ...] [--seed 951] [--folder FOLDER]

Streets of 100 m of four kinds, seen by two scanners (presets `demo`, a sixth of the pulses of a VMX-450, and `hdl32`),
labelled by the default model. In each metre along the smoothed path:

- width: between the true kerb lines across the path, at most 20 m away;
- crossfall, slope: of the least-squares plane of the true ground, 3 m wide, 5 m long, from 0.4 m beside kerbs on;
- clearance: lowest point, of points with their true classes, 2 to 12 m above the true ground between the listed edges,
  or within 1.75 m of the path where none is listed, without those of vehicles, persons and two-wheelers.

`share` is that of the stations with a true value that have a listed one, `false` the number with a listed one alone.
Prints the table and writes it as `road_measures.json` into the folder.

    python benchmarks/road_measures.py --attributes --seed 931

scores types of poles and shapes of plates in place of them: those of listed poles and signs, against the design of the
true object to which most of their points belong. What is listed wrongly counts as false; signs with several plates do
not count. Crown diameters are compared with the circle of the box of the true crown.
"""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
from _common import RESULTS, STREETS, mlsroad, parser, simulated_street
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.inventory.road.stations import REACH, RoadPath
from mlsroad_pipeline.inventory_files.geopackage import read_geopackage
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters
from mlsroad_pipeline.simulation.runtime.stream import SurveyStream
from mlsroad_pipeline.surveys.truth_tables import instances_of_objects, read_truth

LENGTH, STEP, GUTTER = 100, 0.01, 0.4  # metres
FIXED = [c for name, c in TAXONOMY.items() if 20 <= c < 50 or c >= 70 if name != "outlier"]
SIDES = {"left_offset": -1.75, "right_offset": 1.75}
UTILITY = TAXONOMY["utility_pole"]
SHAPES = {
    **dict.fromkeys(("round_sign", "octagonal_sign"), "round"),
    **dict.fromkeys(("triangular_sign", "yield_sign"), "triangle"),
    **dict.fromkeys(("rectangular_sign", "square_sign", "diamond_sign", "street_name_sign"), "rectangle"),
    **dict.fromkeys(("two_post_sign", "chevron_board"), "rectangle"),
}
SEVERAL = ("several_plates_sign", "plate_on_lamp")
UNITS = {"width": "m", "crossfall": "%", "slope": "%", "clearance": "m"}


def truth(stream: SurveyStream, street: Path, path: RoadPath, listed: pd.DataFrame) -> pd.DataFrame:
    """Return the true measures of each station."""
    ground, alignment = stream.street.ground, stream.street.alignment
    right, middle = np.column_stack([path.forward[:, 1], -path.forward[:, 0]]), path.middles[:, :2] - stream.origin[:2]

    def on_street(ahead: float, offset: NDArray | float) -> tuple[NDArray, NDArray]:
        return alignment.locate(middle + ahead * path.forward + np.reshape(offset, (-1, 1)) * right)

    edges = np.full((2, len(path)), np.nan)
    for side, sign in enumerate((-1.0, 1.0)):
        for offset in np.arange(REACH, 0.0, -STEP):  # the nearest place off the carriageway remains
            distance, _ = ground.edge(*on_street(0.0, sign * offset))
            edges[side, distance > 0] = sign * offset
    grid = [(a, o) for a in np.arange(-2.25, 2.5, 0.5) for o in np.arange(-1.45, 1.5, 0.1)]
    heights = np.stack([ground.height(*on_street(a, o)) for a, o in grid], axis=1)
    inside = np.stack([ground.edge(*on_street(a, o))[0] < -GUTTER for a, o in grid], axis=1)
    design = np.column_stack([np.ones(len(grid)), grid])
    planes = [np.linalg.lstsq(design[own], z[own], rcond=None)[0] for own, z in zip(inside, heights, strict=True)]
    _, slope, rise = np.array(planes).T
    found = {"width": edges[1] - edges[0], "crossfall": -100 * rise, "slope": 100 * slope}
    return pd.DataFrame({**found, "clearance": _clearance(stream, street, path, listed)})


def _clearance(stream: SurveyStream, street: Path, path: RoadPath, listed: pd.DataFrame) -> NDArray[np.float64]:
    points = laspy.read(street / "survey.laz")
    xyz = np.asarray(points.xyz)[np.isin(np.asarray(points["label"]), FIXED)]
    row, station, offset = path.locate(xyz)
    local = xyz[row] - stream.origin
    height = local[:, 2] - stream.street.ground.height(*stream.street.alignment.locate(local[:, :2]))
    lane, at = listed[["left_offset", "right_offset"]].fillna(SIDES).to_numpy().T, station.astype(np.int64)
    over = (offset > lane[0, at]) & (offset < lane[1, at]) & (height >= 2.0) & (height < 12.0)
    return pd.Series(height[over]).groupby(at[over]).min().reindex(np.arange(len(path))).to_numpy()


def measured(folder: Path, number: int, seed: int) -> pd.DataFrame:
    """Simulate, label and measure a street; return the listed and the true values of its stations."""
    kind, scanner = STREETS[number]
    street = simulated_street(folder, kind, scanner, seed + number, LENGTH)
    results = folder / f"{kind}_{scanner}"
    mlsroad("label", street, "-o", results, "--overwrite")
    mlsroad("road", results, "--overwrite")
    described = {"preset": scanner, "seed": seed + number, "length": LENGTH, "street": kind, "with_images": False}
    trajectory = read_geopackage(results / "inventory.gpkg").trajectory
    table = pd.read_csv(results / "road/road.csv")
    true = truth(SurveyStream(simulation_parameters(described)), street, RoadPath.along(trajectory), table)
    return table[list(UNITS)].join(true, rsuffix=" true")


def attributes_of(folder: Path, number: int, seed: int) -> pd.DataFrame:
    """Return the listed objects of a street with their true type or shape, labelling it where that is not done."""
    kind, scanner = STREETS[number]
    street = simulated_street(folder, kind, scanner, seed + number, LENGTH)
    results = folder / f"{kind}_{scanner}"
    if not (results / "inventory.gpkg").is_file():
        mlsroad("label", street, "-o", results, "--overwrite")
    objects = read_geopackage(results / "inventory.gpkg").objects
    instance = instances_of_objects(read_truth(street), [results / "survey.laz"])
    true = pd.read_csv(street / "objects.csv").set_index("instance")
    true = true.reindex(objects["object_id"].map(instance)).set_axis(objects.index)
    shape = true["design"].map(SHAPES).fillna("").mask(true["design"].isin(SEVERAL))
    trees = (objects["kind"] == "tree") & true["label"].isin([TAXONOMY["tree"], TAXONOMY["palm"]])
    return objects.assign(
        true_type=np.where(true["label"] == UTILITY, "utility", ""), true_shape=shape,
        crown_error=(objects["crown_diameter"] - np.sqrt(true["length"] * true["width"])).where(trees),
    )  # fmt: skip


def score_attributes(objects: pd.DataFrame) -> list[list[str]]:
    """Return the rows of precision, recall and F of types and shapes, and of errors of crowns; print them."""
    rows = []
    for name, kind, values in (("type", "pole", ["utility"]), ("shape", "sign", ["round", "triangle", "rectangle"])):
        own = objects[(objects["kind"] == kind) & objects[f"true_{name}"].notna()]
        found, true = own["pole_type" if name == "type" else "panel_shape"], own[f"true_{name}"]
        for value in values:
            listed, wanted, right = found == value, true == value, ((found == value) & (true == value)).sum()
            n, m = listed.sum(), wanted.sum()
            parts = right / max(n, 1), right / max(m, 1), 2 * right / max(n + m, 1)
            rows.append([f"{kind}: {value}", str(m), str(n), *(f"{x:.2f}" for x in parts)])
    crown = objects["crown_error"].dropna()
    errors = f"median error {crown.abs().median():.2f} m, bias {crown.median():+.2f} m"
    print(f"crown diameter: {len(crown)} trees, {errors}")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return rows


def rows_of(name: str, values: pd.DataFrame) -> list[list[str]]:
    """Return the rows of a street, and print them."""
    rows = []
    for measure, unit in UNITS.items():
        listed, true = values[measure], values[f"{measure} true"]
        error, known = (listed - true).dropna(), int(true.notna().sum())
        found = [f"{x:.3f}" for x in error.abs().quantile([0.5, 0.9])] if len(error) else ["", ""]
        bias = f"{error.median():+.3f}" if len(error) else ""
        counts = [str(known), f"{len(error) / max(known, 1):.2f}", str((listed.notna() & true.isna()).sum())]
        rows.append([f"{name}: {measure}", unit, *found, bias, *counts])
        print("| " + " | ".join(rows[-1]) + " |", flush=True)
    return rows


def main() -> None:
    """Measure all streets and print the errors."""
    arguments, names = parser(__doc__), [f"{kind}_{scanner}" for kind, scanner in STREETS]
    arguments.add_argument("--only", nargs="+", choices=names, default=names)
    arguments.add_argument("--seed", type=int, default=951)
    arguments.add_argument("--attributes", action="store_true", help="score types of poles and shapes of plates")
    arguments.add_argument("--folder", type=Path, default=RESULTS / "road_measures")
    options = arguments.parse_args()
    folder, record, every = options.folder.absolute(), [], []
    if options.attributes:
        every = [attributes_of(folder, names.index(name), options.seed) for name in options.only]
        record = score_attributes(pd.concat(every, ignore_index=True))
        (folder / "object_attributes.json").write_text(json.dumps(record, indent=1) + "\n")
        return
    print(
        "| data and measure | unit | median error | 90 % quantile | bias | true | share | false |\n" + 8 * "|---" + "|"
    )
    for name in options.only:
        every.append(measured(folder, names.index(name), options.seed))
        record += rows_of(name, every[-1])
    record += rows_of("all streets", pd.concat(every))
    (folder / "road_measures.json").write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
