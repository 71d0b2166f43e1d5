"""Errors of the measures of `mlsroad road` on simulated streets, against the street as it was drawn.

    python benchmarks/road_measures.py [--only town_demo ...] [--seed 951] [--folder FOLDER]

Streets of 100 m of four kinds (town, suburb, ring_road, campus), seen by two scanners (presets `demo`, a sixth of the
pulses of a VMX-450, and `hdl32`), labelled by the default model. In each metre along the smoothed path:

- width: between the true kerb lines across the path; where it meets none within 15 m, a listed width is `false`;
- crossfall, slope: of the least-squares plane of the true ground, 3 m wide and 5 m long, from 0.4 m beside kerbs on;
- clearance: lowest point, of points with their true classes, 2 to 12 m above the true ground between the listed edges,
  or within 1.75 m of the path where none is listed, without those of vehicles, persons and two-wheelers.

`share` is the share of the stations with a true value that have a listed one. Prints a table in Markdown and writes
`road_measures.json` into the folder.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

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

LENGTH, STEP, GUTTER = 100, 0.01, 0.4
FIXED = [c for name, c in TAXONOMY.items() if 20 <= c < 50 or c >= 70 if name != "outlier"]
SIDES = {"left_offset": -1.75, "right_offset": 1.75}
UNITS = {"width": "m", "crossfall": "%", "slope": "%", "clearance": "m"}


class Errors(NamedTuple):
    """Errors of a measure: listed minus true."""

    errors: NDArray[np.float64]
    true: int  # Stations with a true value
    false: int  # Stations with a listed value alone


def truth(stream: SurveyStream, street: Path, path: RoadPath, listed: pd.DataFrame) -> pd.DataFrame:
    """Return the true measures of each station."""
    ground, alignment = stream.street.ground, stream.street.alignment
    number, right = np.arange(len(path)), np.column_stack([path.forward[:, 1], -path.forward[:, 0]])
    middle = path.middles[:, :2] - stream.origin[:2]

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
    return pd.DataFrame({**found, "clearance": _clearance(stream, street, path, listed)}, index=number)


def _clearance(stream: SurveyStream, street: Path, path: RoadPath, listed: pd.DataFrame) -> NDArray[np.float64]:
    points = laspy.read(street / "survey.laz")
    xyz = np.asarray(points.xyz)[np.isin(np.asarray(points["label"]), FIXED)]
    row, station, offset = path.locate(xyz)
    local = xyz[row] - stream.origin
    height = local[:, 2] - stream.street.ground.height(*stream.street.alignment.locate(local[:, :2]))
    lane, at = listed[["left_offset", "right_offset"]].fillna(SIDES).to_numpy().T, station.astype(np.int64)
    over = (offset > lane[0, at]) & (offset < lane[1, at]) & (height >= 2.0) & (height < 12.0)
    return pd.Series(height[over]).groupby(at[over]).min().reindex(np.arange(len(path))).to_numpy()


def errors_of(folder: Path, number: int, seed: int) -> dict[str, Errors]:
    """Simulate, label and measure a street, and return the errors of its measures."""
    kind, scanner = STREETS[number]
    street = simulated_street(folder, kind, scanner, seed + number, LENGTH)
    results = folder / f"{kind}_{scanner}"
    mlsroad("label", street, "-o", results, "--overwrite")
    mlsroad("road", results, "--overwrite")
    described = {"preset": scanner, "seed": seed + number, "length": LENGTH, "street": kind, "with_images": False}
    stream = SurveyStream(simulation_parameters(described))
    trajectory = read_geopackage(results / "inventory.gpkg").trajectory
    assert trajectory is not None, f"{results}: no path"
    table = pd.read_csv(results / "road/road.csv")
    true = truth(stream, street, RoadPath.along(trajectory), table)
    found = {}
    for name in UNITS:
        error = (table[name] - true[name]).to_numpy()
        false = int((table[name].notna() & true[name].isna()).sum())
        found[name] = Errors(error[np.isfinite(error)], int(true[name].notna().sum()), false)
    return found


def row(name: str, measure: str, values: Errors) -> list[str]:
    """Return a row of the table."""
    size = np.abs(values.errors) if len(values.errors) else np.array([np.nan])
    quantiles = [f"{q:.3f}" for q in np.quantile(size, [0.5, 0.9])]
    bias = f"{np.median(values.errors):+.3f}" if len(values.errors) else ""
    share = f"{len(values.errors) / max(values.true, 1):.2f}"
    return [f"{name}: {measure}", UNITS[measure], *quantiles, bias, str(values.true), share, str(values.false)]


def main() -> None:
    """Measure all streets and print the errors."""
    arguments = parser(__doc__)
    names = [f"{kind}_{scanner}" for kind, scanner in STREETS]
    arguments.add_argument("--only", nargs="+", choices=names, default=names)
    arguments.add_argument("--seed", type=int, default=951)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "road_measures")
    options = arguments.parse_args()
    folder = options.folder.absolute()
    record, every = [], {name: [] for name in UNITS}
    print(
        "| data and measure | unit | median error | 90 % quantile | bias | true | share | false |\n" + "|---" * 8 + "|"
    )
    for name in options.only:
        for measure, values in errors_of(folder, names.index(name), options.seed).items():
            every[measure].append(values)
            record.append(row(name, measure, values))
            print("| " + " | ".join(record[-1]) + " |", flush=True)
    for measure, parts in every.items():
        errors, true, false = zip(*parts, strict=True)
        record.append(row("all streets", measure, Errors(np.concatenate(errors), sum(true), sum(false))))
        print("| " + " | ".join(record[-1]) + " |", flush=True)
    (folder / "road_measures.json").write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
