"""Places of a road to look at: what is inside the envelope, what is low, and the measures every ten metres."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.table import Field
from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, RoadPath
from mlsroad_pipeline.algorithms.inventory.road.table import INTRUDED

LOW, MEASURED = "low", "measured"
"""States of places that are no intrusions: below the least clearance, and every ten metres."""

PLACE_FIELDS: dict[str, Field] = {
    "place": Field("str", "Place", "Name of the place: the station of its lowest point, else its first one."),
    "kind": Field("str", "Kind", "station."),
    "state": Field(
        "str", "State", "intruded (into the envelope), low (clearance) or measured.", (INTRUDED, LOW, MEASURED)
    ),
    "x": Field("float64", "Easting [m]", "First coordinate of the lowest point; of the path where it is measured."),
    "y": Field("float64", "Northing [m]", "Second coordinate of it."),
    "z": Field("float64", "Elevation [m]", "Its elevation."),
    "from_station": Field("float64", "From station [m]", "Begin of the place along the path."),
    "to_station": Field("float64", "To station [m]", "End of the place along the path."),
    "height": Field("float64", "Height [m]", "Lowest point above the road."),
    "class": Field("str", "Class", "Class of the lowest point."),
    "object_id": Field("int64", "Object", "The object that it belongs to, 0 without one."),
    "reason": Field("str", "Reason", "The measures in words."),
    "checked": Field(
        "str", "Checked", "Decision of a user about the state: right, wrong or empty.", ("right", "wrong")
    ),
}
"""Columns of the places; `checked` is added where users have decided."""

CLEARANCE = 4.5
"""Clearance below which a place is low where no envelope is given (RASt 06), metres."""

_LENGTH = 10  # of a place that is measured, stations
_GAP = 2  # stations: places of one object nearer to each other are one


def road_places(table: pd.DataFrame, path: RoadPath, *, least_clearance: float = CLEARANCE) -> pd.DataFrame:
    """Return the places of a road by station; `table` has the columns of `ROAD_FIELDS`.

    Stations in a row with the same object, or the same class without an object, are one place.
    """
    intruded = (table["envelope"] == INTRUDED).to_numpy()
    same = table["clearance_object"].eq(table["intrusion_object"]) & table["clearance_class"].eq(
        table["intrusion_class"]
    )
    low = (table["clearance"] < least_clearance).to_numpy() & ~(intruded & same.to_numpy())
    rows = [_lowest(table, path, own, "intrusion", INTRUDED) for own in _runs(table, intruded, "intrusion")]
    rows += [_lowest(table, path, own, "clearance", LOW) for own in _runs(table, low, "clearance")]
    rows += [_measured(table.iloc[first : first + _LENGTH]) for first in range(0, len(table), _LENGTH)]
    names = [name for name in PLACE_FIELDS if name != "checked"]
    found = pd.DataFrame(rows, columns=names).astype({name: PLACE_FIELDS[name].dtype for name in names})
    return found.round(3).sort_values("from_station", kind="stable", ignore_index=True)


def _runs(table: pd.DataFrame, chosen: NDArray[np.bool_], name: str) -> list[NDArray[np.int64]]:
    """Return the rows of each place among the chosen stations."""
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return []
    number, kind = (table[f"{name}_{part}"].to_numpy()[rows] for part in ("object", "class"))
    other = (number[1:] != number[:-1]) | ((number[1:] == 0) & (kind[1:] != kind[:-1]))
    return np.split(rows, np.flatnonzero(other | (np.diff(rows) > _GAP)) + 1)


def _lowest(table: pd.DataFrame, path: RoadPath, rows: NDArray[np.int64], name: str, state: str) -> dict[str, object]:
    at = rows[[int(np.argmin(table[name].to_numpy()[rows]))]]
    row = table.iloc[int(at[0])]
    height, offset, number = float(row[name]), float(row[f"{name}_offset"]), int(row[f"{name}_object"])
    what = f"{row[f'{name}_class']}{f' {number}' if number else ''}"
    side = f"{abs(offset):.1f} m {'right' if offset > 0 else 'left'}"
    begin, end = (float(table["station"].iloc[int(k)]) for k in (rows[0], rows[-1]))
    x, y = path.across(at, np.array([offset]))[0]
    return {
        "place": f"{row['station']:.1f}", "kind": "station", "state": state, "x": x, "y": y, "z": row["z"] + height,
        "from_station": begin - STEP / 2, "to_station": end + STEP / 2, "height": height,
        "class": row[f"{name}_class"], "object_id": number, "reason": f"{what}, {height:.2f} m above the road, {side}",
    }  # fmt: skip


def _measured(own: pd.DataFrame) -> dict[str, object]:
    low = own["clearance"].min()
    words = (
        ("width", own["width"].median(), "m"),
        ("crossfall", own["crossfall"].median(), "%"),
        ("clearance", low, "m"),
    )
    first, middle = own.iloc[0], own.iloc[len(own) // 2]
    start = float(first["station"]) - STEP / 2
    reason = ", ".join(f"{name} {value:.2f} {unit}" for name, value, unit in words if np.isfinite(value))
    return {
        "place": f"{start:g}", "kind": "station", "state": MEASURED, "x": middle["x"], "y": middle["y"],
        "z": middle["z"], "from_station": start, "to_station": float(own["station"].iloc[-1]) + STEP / 2,
        "height": low, "class": "", "object_id": 0, "reason": reason or "not seen",
    }  # fmt: skip
