"""The road objects of a survey as geometries, which the files of the inventory share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from pyproj import CRS
from pyproj.exceptions import CRSError

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.inventory.table import FIELDS, OBJECT_FIELDS
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory

MAY_LACK = ("facing_from", "method", "model_version")
"""Columns of text that are NULL in files where they are empty."""


@dataclass(frozen=True)
class RoadInventory:
    """What is known of the objects of a survey.

    Parameters
    ----------
    objects : DataFrame
        Columns of `OBJECT_FIELDS`, as `merge_across_scenes` gives them.
    crs : str or None
        Coordinate reference system as WKT or a code such as ``EPSG:25832``; None is written as undefined.
    trajectory : Trajectory or None
        The survey's path.
    """

    objects: pd.DataFrame
    crs: str | None = None
    trajectory: Trajectory | None = None


def checked(inventory: RoadInventory, target: Path) -> tuple[pd.DataFrame, CRS | None]:
    """Return an inventory's table with typed columns and its reference system.

    Parameters
    ----------
    inventory : RoadInventory
        The inventory.
    target : Path
        The file that it is written to, which messages name.

    Returns
    -------
    table : DataFrame
        Columns of `OBJECT_FIELDS`.
    crs : CRS or None
        The reference system.

    Raises
    ------
    DataError
        If a column is missing or the CRS is not understood.
    """
    missing = [name for name in OBJECT_FIELDS if name not in inventory.objects]
    if missing:
        raise DataError(f"{target}: the inventory lacks the column {missing[0]!r}")
    try:
        crs = None if inventory.crs is None else CRS.from_user_input(inventory.crs)
    except CRSError as error:
        raise DataError(f"{target}: the coordinate reference system {inventory.crs!r} is not understood") from error
    return inventory.objects[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS).reset_index(drop=True), crs


def attributes(table: pd.DataFrame) -> pd.DataFrame:
    """Return what is written beside the geometries: all columns but the footprint, with NULL for what is not known.

    Parameters
    ----------
    table : DataFrame
        Columns of `OBJECT_FIELDS`.

    Returns
    -------
    DataFrame
        The same rows.
    """
    kept = table[[name for name in FIELDS if name != "footprint"]].copy()
    for name in MAY_LACK:
        kept[name] = kept[name].astype(object).where(kept[name] != "", None)
    return kept


def base_points(table: pd.DataFrame) -> np.ndarray:
    """Return the base points of objects.

    Parameters
    ----------
    table : DataFrame
        Columns `x, y, z`.

    Returns
    -------
    ndarray of shapely Point, shape (n,)
        Points with heights.
    """
    points: np.ndarray = shapely.points(table[["x", "y", "z"]].to_numpy())
    return points


def hulls(table: pd.DataFrame) -> np.ndarray:
    """Return the footprints of objects.

    Parameters
    ----------
    table : DataFrame
        Column `footprint`.

    Returns
    -------
    ndarray of shapely Polygon or None, shape (n,)
        Counterclockwise polygons, None where there is no area.
    """
    shapes: np.ndarray = shapely.from_wkt([text or None for text in table["footprint"]])
    return shapes


def vehicle_boxes(objects: pd.DataFrame) -> np.ndarray:
    """Return the oriented boxes of vehicles as polygons at the height of their base.

    Parameters
    ----------
    objects : DataFrame
        Columns `x, y, z, length, width, heading`.

    Returns
    -------
    ndarray of shapely Polygon, shape (n,)
        Rectangles, counterclockwise.
    """
    centre = objects[["x", "y"]].to_numpy()
    turn = np.radians(objects["heading"].to_numpy())
    along = np.column_stack([np.sin(turn), np.cos(turn)]) * objects["length"].to_numpy()[:, None] / 2
    across = np.column_stack([-np.cos(turn), np.sin(turn)]) * objects["width"].to_numpy()[:, None] / 2
    corners = np.stack(
        [centre - along - across, centre + along - across, centre + along + across, centre - along + across], 1
    )
    heights = np.repeat(objects["z"].to_numpy()[:, None, None], 4, axis=1)
    boxes: np.ndarray = shapely.polygons(np.concatenate([corners, heights], axis=2))
    return boxes
