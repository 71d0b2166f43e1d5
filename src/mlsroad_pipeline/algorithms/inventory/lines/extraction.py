"""Table of the lines of a road: columns, units, stations, numbers."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.table import Field
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

LINE_FIELDS: dict[str, Field] = {
    "line_id": Field("int64", "Line", "Number of the line, from 1, by kind and station."),
    "kind": Field(
        *("str", "Kind", "What it is: kerb, wire, barrier, lane_line, stop_line, crossing or other_marking."),
        LINE_KINDS,
    ),
    "score": Field(
        "float64", "Score", "Mean probability of the class wire of a wire's points; probability of a marking, 0 to 1."
    ),
    "length": Field("float64", "Length [m]", "Length in plan."),
    "height": Field(
        "float64", "Height [m]", "Median height of a kerb's upper edge, or a barrier's top, above its foot."
    ),
    "least_height": Field("float64", "Least height [m]", "Smallest height of the vertices of a kerb or barrier."),
    "most_height": Field("float64", "Largest height [m]", "Largest height of the vertices of a kerb or barrier."),
    "sag": Field("float64", "Sag [m]", "Largest distance of a wire below the chord between its ends."),
    "clearance": Field("float64", "Clearance [m]", "Smallest height of a wire's points above the ground."),
    "width": Field("float64", "Width [m]", "Width of a marking; of a crossing the length of its bars."),
    "contrast": Field("float64", "Contrast", "Intensity of a marking above the road, standard deviations of the road."),
    "pattern": Field(
        "str", "Pattern", "Pattern of a lane line: solid, or dashed for each dash of one.", ("solid", "dashed")
    ),
    "from_station": Field("float64", "From station [m]", "Smallest way along the trajectory beside the line."),
    "to_station": Field("float64", "To station [m]", "Largest way along the trajectory beside the line."),
    "offset": Field("float64", "Offset [m]", "Median distance from the trajectory, positive to the right."),
    "x": Field("float64", "First easting [m]", "First coordinate of its first vertex."),
    "y": Field("float64", "First northing [m]", "Second coordinate of its first vertex."),
    "line": Field(
        "str",
        "Line",
        "WKT (LINESTRING Z): the foot of a kerb, its upper side on the left; a wire; a barrier's foot; a marking.",
    ),
}
"""Columns of the lines; NaN where a kind has no such measure, and stations without a trajectory."""

_MARKINGS = ("lane_line", "stop_line", "crossing", "other_marking")
_FIELDS_OF_KINDS: dict[str, tuple[str, ...]] = {
    "score": ("wire", *_MARKINGS),
    **dict.fromkeys(("height", "least_height", "most_height"), ("kerb", "barrier")),
    **dict.fromkeys(("sag", "clearance"), ("wire",)),
    **dict.fromkeys(("width", "contrast"), _MARKINGS),
    "pattern": ("lane_line",),
}


def line_fields_of_kind(kind: str) -> list[str]:
    """Return the columns that lines of a kind have, in the order of `LINE_FIELDS`.

    Examples
    --------
    >>> line_fields_of_kind("wire")[:5]
    ['line_id', 'kind', 'score', 'length', 'sag']
    """
    return [name for name in LINE_FIELDS if kind in _FIELDS_OF_KINDS.get(name, (kind,))]


ADDED_FIELDS = ("width", "contrast", "pattern")
"""Columns that files of earlier versions lack; they are read as unknown."""

_DECIMALS = 3


def line_row(
    kind: str, vertices: NDArray[np.float64], trajectory: Trajectory | None, **measures: float | str
) -> dict[str, object]:
    """Return the row of a line in `LINE_FIELDS`, from vertices in world coordinates; `line_id` is 0."""
    row: dict[str, object] = dict.fromkeys(LINE_FIELDS, np.nan) | {
        "line_id": 0,
        "kind": kind,
        "pattern": "",
        **measures,
    }
    row["length"] = float(np.hypot(*np.diff(vertices[:, :2], axis=0).T).sum())
    row["x"], row["y"] = vertices[0, :2].tolist()
    row["line"] = shapely.to_wkt(shapely.LineString(vertices), rounding_precision=_DECIMALS, trim=False)
    if trajectory is not None:
        station, across = trajectory.locate(vertices)
        row |= {"from_station": station.min(), "to_station": station.max(), "offset": np.median(across)}
    return row


def line_table(rows: Sequence[dict[str, object]]) -> pd.DataFrame:
    """Return lines sorted by station, else by place, and numbered, with lengths to the millimetre."""
    table = pd.DataFrame(list(rows), columns=list(LINE_FIELDS)).round(_DECIMALS)
    table = table.sort_values(["from_station", "x", "y"], kind="stable", ignore_index=True)
    return numbered([table])


def lines_near(lines: pd.DataFrame, path: Trajectory, reach: float) -> pd.DataFrame:
    """Return the lines with a vertex at most `reach` metres from a path."""
    if lines.empty:
        return lines
    xyz, owner = shapely.get_coordinates(shapely.from_wkt(lines["line"].to_numpy()), include_z=True, return_index=True)
    nearest = np.full(len(lines), np.inf)
    np.minimum.at(nearest, owner, path.distance(xyz))
    return lines[nearest <= reach]


def numbered(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return several tables of lines as one, numbered from 1 by kind."""
    filled = [table for table in tables if len(table)]
    joined = pd.concat(filled, ignore_index=True) if filled else pd.DataFrame(columns=list(LINE_FIELDS))
    joined = joined.sort_values("kind", kind="stable", ignore_index=True)
    joined["line_id"] = np.arange(len(joined)) + 1
    return joined.astype({name: field.dtype for name, field in LINE_FIELDS.items()})
