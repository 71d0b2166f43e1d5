"""Inventory with objects of each kind, unlike each other in every field."""

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.inventory.lines.extraction import LINE_FIELDS
from mlsroad_pipeline.algorithms.inventory.lines.layers import LINE_KINDS
from mlsroad_pipeline.algorithms.inventory.objects.sections import section_table
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory

UTM = "EPSG:25833"
RING = "{x:.2f} {y:.2f}, {x1:.2f} {y:.2f}, {x1:.2f} {y1:.2f}, {x:.2f} {y:.2f}"


def planted(number, kind, **values):
    """Give an object every field of its kind, unlike those of the others."""
    row = {name: {"float64": np.nan, "int64": 0, "str": ""}[dtype] for name, dtype in OBJECT_FIELDS.items()}
    x, y = 391_000.125 + 7 * number, 5_820_000.5 - 3 * number
    row |= {"object_id": number, "class": kind, "kind": kind, "score": 0.8125 + number / 64, "x": x, "y": y, "z": 34.25}
    row |= {"height": 2.5 * number, "width": 1.75, "point_count": 100 * number, "scene": "survey.a.scene_00001"}
    row |= {"first_time": 412_345_678.0 + number, "last_time": 412_345_690.0, "file_count": 2, "passes": 1}
    row |= {f"{axis}_{end}": row[axis] + (end == "max") for axis in "xyz" for end in ("min", "max")}
    row["footprint"] = f"POLYGON (({RING.format(x=x, y=y, x1=x + 1, y1=y + 1)}))"
    return row | values


def planted_lines():
    """Return a line of each kind."""
    rows = []
    for number, kind in enumerate(LINE_KINDS, start=1):
        x, y = 391_000.25 + number, 5_820_000.5
        row = {"line_id": number, "kind": kind, "length": 5.0, "height": 0.125, "least_height": 0.0625, "x": x, "y": y}
        row |= {"most_height": 0.25, "from_station": 1.5, "to_station": 6.5, "offset": -3.0, "sag": 0.5}
        row |= {
            "clearance": 5.25,
            "score": 0.75,
            "width": 0.125,
            "contrast": 4.5,
            "pattern": "dashed",
            "line": f"LINESTRING Z ({x:.3f} {y:.3f} 34.250, {x + 3:.3f} {y + 4:.3f} 34.500)",
        }
        rows.append(row)
    return pd.DataFrame(rows)[list(LINE_FIELDS)].astype({name: field.dtype for name, field in LINE_FIELDS.items()})


def planted_inventory():
    """Return an inventory with each kind of object and line, a trajectory and sections."""
    rows = [
        planted(1, "pole", tilt=2.5, lean_azimuth=210.0, station=12.5, offset=-3.25, reasons="slender; stands free"),
        planted(2, "sign", facing=90.0, facing_from="post", pole_id=1, panel_bottom=2.2, footprint=""),
        planted(3, "sign", facing=45.0, facing_from="unknown", reasons="pl\u00e4ttchen \u2265 2 m; " * 20),
        planted(4, "sign"),
        planted(5, "vehicle", length=4.5, heading=30.0, method="boosted_trees", **{"class": "car/van"}),
        planted(6, "tree", crown_diameter=6.5, first_time=np.nan, last_time=np.nan),
    ]
    path = Trajectory.from_positions(
        [[391_000.0, 5_820_000, 35], [391_050.0, 5_820_000, 36], [391_099.0, 5_819_990, 36]]
    )
    objects = pd.DataFrame(rows)[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)
    return RoadInventory(objects, UTM, path, section_table(objects, path.length), planted_lines())
