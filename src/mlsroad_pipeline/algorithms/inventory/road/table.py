"""Table of a road: a row per metre of station, and medians of sections."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.table import Field
from mlsroad_pipeline.algorithms.inventory.road.clearance import Lowered
from mlsroad_pipeline.algorithms.inventory.road.edges import Edges
from mlsroad_pipeline.algorithms.inventory.road.stations import STEP, RoadPath
from mlsroad_pipeline.algorithms.inventory.road.surface import Ground, Planes, evenness, ruts

ROAD_FIELDS: dict[str, Field] = {
    "station": Field("float64", "Station [m]", "Middle of the station along the path."),
    "x": Field("float64", "Easting [m]", "First coordinate of the path there."),
    "y": Field("float64", "Northing [m]", "Second coordinate of the path there."),
    "z": Field("float64", "Height [m]", "Height of the road on the path."),
    "width": Field("float64", "Width [m]", "Distance between the edges of the carriageway."),
    "left_edge": Field("str", "Left edge", "Evidence: kerb, kerb_bridged or paved; empty where it is not seen."),
    "right_edge": Field("str", "Right edge", "Evidence: kerb, kerb_bridged or paved; empty where it is not seen."),
    "left_offset": Field("float64", "Left offset [m]", "Offset of the left edge from the path; negative."),
    "right_offset": Field("float64", "Right offset [m]", "Offset of the right edge from the path."),
    "crossfall": Field("float64", "Crossfall [%]", "Of the lane driven, positive where it falls to the right."),
    "slope": Field("float64", "Longitudinal slope [%]", "Of the lane driven, positive where it rises."),
    "rut_left": Field("float64", "Left rut [mm]", "Depth of the left rut under a 2 m straightedge."),
    "rut_right": Field("float64", "Right rut [mm]", "Depth of the right rut under a 2 m straightedge."),
    "evenness": Field("float64", "Evenness [mm]", "Largest gap under a 4 m straightedge in the right wheel path."),
    "clearance": Field("float64", "Clearance [m]", "Lowest point from 2 to 12 m above the carriageway."),
    "clearance_offset": Field("float64", "Offset of clearance [m]", "Its offset from the path."),
    "clearance_class": Field("str", "Class of clearance", "Its class."),
    "clearance_object": Field("int64", "Object of clearance", "The object_id that it belongs to, 0 without one."),
    "envelope": Field("str", "Envelope", "free or intruded; empty without an envelope or a road."),
    "intrusion": Field("float64", "Intrusion [m]", "Lowest point in the envelope, above the road."),
    "intrusion_offset": Field("float64", "Offset of intrusion [m]", "Its offset from the path."),
    "intrusion_class": Field("str", "Class of intrusion", "Its class."),
    "intrusion_object": Field("int64", "Object of intrusion", "The object_id that it belongs to, 0 without one."),
}
"""Columns of the road. Offsets are positive to the right; NaN where something is not seen."""

ROAD_LAYERS = ("road", "road_widths", "road_sections", "intrusions", "sight")
"""Layers of stations, lines from edge to edge, sections, intruded and low places, and ways that see a sign."""

FREE, INTRUDED = "free", "intruded"

_MEDIANS = ("width", "crossfall", "slope", "rut_left", "rut_right", "evenness")
_DECIMALS = {"crossfall": 2, "slope": 2, "rut_left": 1, "rut_right": 1, "evenness": 1}


def road_table(
    path: RoadPath, ground: Ground, planes: Planes, edges: Edges, above: Lowered, inside: Lowered | None,
    classes: Sequence[str],
) -> pd.DataFrame:  # fmt: skip
    """Return the rows of all stations, columns of `ROAD_FIELDS`; `inside` are the points of an envelope."""
    depth = ruts(ground, planes, edges.offset)
    values = {
        "station": path.station[:-1] + STEP / 2, "x": path.middles[:, 0], "y": path.middles[:, 1],
        "z": planes.height + ground.base, "width": edges.width,
        "left_edge": edges.evidence[0], "right_edge": edges.evidence[1],
        "left_offset": edges.offset[0], "right_offset": edges.offset[1],
        "crossfall": 100 * planes.crossfall, "slope": 100 * planes.slope,
        "rut_left": 1000 * depth[0], "rut_right": 1000 * depth[1], "evenness": 1000 * evenness(ground, planes),
        **_named("clearance", above, classes),
    }  # fmt: skip
    table = pd.DataFrame(values)
    if inside is not None:
        known = np.isfinite(planes.height)
        state = np.select([~known, np.isfinite(inside.height)], ["", INTRUDED], FREE)
        table = table.assign(envelope=state, **_named("intrusion", inside, classes))
    blank: dict[str, str | int | float] = {"str": "", "int64": 0, "float64": np.nan}
    for name, field in ROAD_FIELDS.items():
        if name not in table:
            table[name] = blank[field.dtype]
    table = table[list(ROAD_FIELDS)].astype({name: field.dtype for name, field in ROAD_FIELDS.items()})
    return table.round({name: _DECIMALS.get(name, 3) for name in ROAD_FIELDS})


def _named(name: str, found: Lowered, classes: Sequence[str]) -> dict[str, NDArray]:
    names = np.array([*classes, ""], dtype=object)[found.label]
    return {
        name: found.height, f"{name}_offset": found.offset, f"{name}_class": names, f"{name}_object": found.number,
    }  # fmt: skip


def section_medians(table: pd.DataFrame, sections: pd.DataFrame) -> pd.DataFrame:
    """Return the sections of a road with medians of the measures, the least width and the least clearance.

    `measured` is the share of stations with a width.
    """
    rows = []
    for low, high in sections[["from_station", "to_station"]].to_numpy(dtype=np.float64):
        own = table[(table["station"] >= low) & (table["station"] < high)]
        least = {f"least_{name}": own[name].min() for name in ("width", "clearance")}
        share = own["width"].notna().mean() if len(own) else 0.0
        n = int((own["envelope"] == INTRUDED).sum())
        rows.append({**{name: own[name].median() for name in _MEDIANS}, **least, "measured": share, "intruded": n})
    found = pd.DataFrame(rows, columns=[*_MEDIANS, "least_width", "least_clearance", "measured", "intruded"])
    found = found.round({name: _DECIMALS.get(str(name), 3) for name in found})
    return pd.concat([sections.reset_index(drop=True), found], axis=1)
