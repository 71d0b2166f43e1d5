"""Boxes of vehicles in KITTI's object labels, in the coordinates of the scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError

VEHICLES = ("Car", "Van", "Truck", "Tram")
UNKNOWN = "DontCare"
REACH = 80.0
"""Range up to which the labels are complete, metres."""


def kitti_boxes(path: Path) -> tuple[pd.DataFrame, shapely.Geometry]:
    """Return the vehicles of ``label_2/NAME.txt``, and where they are complete; reads ``calib/NAME.txt`` too.

    The labels cover what the left colour camera sees, without the directions that they mark as unknown.
    """
    calibration = path.parents[1] / "calib" / path.name
    if not calibration.is_file():
        raise ReadError(f"{path}: the calibration {calibration} does not exist")
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    try:
        matrices = _matrices(calibration)
        boxes = pd.DataFrame([_box(row, matrices["to_scan"]) for row in rows if row[0] in VEHICLES], columns=COLUMNS)
        unknown = [(float(row[4]), float(row[6])) for row in rows if row[0] == UNKNOWN]
        camera = matrices["P2"]
        seen = _wedge(camera, 0.0, 2 * camera[0, 2])  # the principal point is the middle of the image
        region = shapely.difference(seen, shapely.union_all([_wedge(camera, *limits) for limits in unknown]))
    except (ValueError, IndexError, KeyError, shapely.errors.ShapelyError) as error:  # the last for NaN
        raise ReadError(f"{path}: not a KITTI label file: {error}") from error
    return boxes, region


COLUMNS = ["kind", "name", "x", "y", "z", "height", "width", "length", "heading"]


def _matrices(path: Path) -> dict[str, NDArray[np.float64]]:
    values = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        name, sign, numbers = line.partition(":")
        if sign:
            values[name] = np.array(numbers.split(), dtype=np.float64)
    rectify, camera = np.eye(4), np.eye(4)
    rectify[:3, :3] = values["R0_rect"].reshape(3, 3)
    camera[:3] = values["Tr_velo_to_cam"].reshape(3, 4)
    to_scan: NDArray[np.float64] = np.linalg.inv(rectify @ camera).astype(np.float64)
    return {"P2": values["P2"].reshape(3, 4), "to_scan": to_scan}


def _box(row: list[str], to_scan: NDArray[np.float64]) -> list[object]:
    height, width, length, x, y, z, turn = (float(value) for value in row[8:15])
    place = to_scan @ [x, y, z, 1.0]
    along = to_scan[:3, :3] @ [np.cos(turn), 0.0, -np.sin(turn)]
    heading = np.degrees(np.arctan2(along[0], along[1])) % 180.0
    return ["vehicle", row[0], *place[:3], height, width, length, heading]


def _wedge(camera: NDArray[np.float64], left: float, right: float) -> shapely.Polygon:
    """Return what lies between two columns of the image in plan, x forward and y to the left."""
    slopes = [(camera[0, 2] - column) / camera[0, 0] for column in (left, right)]
    return shapely.Polygon([(0.0, 0.0), *((REACH, REACH * slope) for slope in slopes)])
