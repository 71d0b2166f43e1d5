"""The inventory as a GeoPackage: layers of typed features that a GIS opens."""

from __future__ import annotations

import os
import uuid
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import shapely
from kedro.io import AbstractDataset
from pyproj import CRS
from pyproj.exceptions import CRSError

from mlsroad_pipeline.algorithms.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.inventory_table import OBJECT_FIELDS
from mlsroad_pipeline.algorithms.trajectory import Trajectory

LAYERS = {"poles": "pole", "signs": "sign", "trees": "tree", "vehicles": "vehicle"}
"""Layer name to the kind of object in it."""

_FIXED_DATE = "2000-01-01T00:00:00.000Z"
_POINT, _POLYGON, _LINE = "Point Z", "Polygon Z", "LineString Z"


@dataclass(frozen=True)
class RoadInventory:
    """What a GeoPackage of a survey holds.

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


def footprints(objects: pd.DataFrame) -> np.ndarray:
    """Return the oriented boxes of vehicles as polygons at the height of their base.

    Parameters
    ----------
    objects : DataFrame
        Columns `x, y, z, length, width, azimuth`.

    Returns
    -------
    ndarray of shapely Polygon, shape (n,)
        Rectangles, counterclockwise.
    """
    centre = objects[["x", "y"]].to_numpy()
    turn = np.radians(objects["azimuth"].to_numpy())
    along = np.column_stack([np.sin(turn), np.cos(turn)]) * objects["length"].to_numpy()[:, None] / 2
    across = np.column_stack([-np.cos(turn), np.sin(turn)]) * objects["width"].to_numpy()[:, None] / 2
    corners = np.stack(
        [centre - along - across, centre + along - across, centre + along + across, centre - along + across], 1
    )
    heights = np.repeat(objects["z"].to_numpy()[:, None, None], 4, axis=1)
    return shapely.polygons(np.concatenate([corners, heights], axis=2))


def _write_layer(
    path: Path, layer: str, table: pd.DataFrame, *, geometry: np.ndarray, kind: str, crs: CRS | None
) -> None:
    frame = gpd.GeoDataFrame(table.reset_index(drop=True), geometry=gpd.GeoSeries(geometry, dtype="geometry"), crs=crs)
    with warnings.catch_warnings():
        # A survey without a known CRS is normal; GeoPackage has a code for it (-1, undefined Cartesian).
        warnings.filterwarnings("ignore", message=".*crs.* was not provided", category=UserWarning)
        pyogrio.write_dataframe(frame, path, layer=layer, driver="GPKG", geometry_type=kind, append=path.exists())


def write_geopackage(inventory: RoadInventory, path: str | Path) -> None:
    """Write an inventory as layers of a GeoPackage.

    Layers: `objects` (points, all kinds), `poles`, `signs`, `trees` (points), `vehicles` (footprints) and `trajectory`
    (a line). The file appears whole or not at all, and the same inventory gives the same features in the same order.
    Layers without objects are there, empty and typed; `trajectory` is left out where there is none.

    Parameters
    ----------
    inventory : RoadInventory
        The objects, where they lie, and the path.
    path : str or Path
        The file, replaced if it exists; its folder must exist.

    Raises
    ------
    DataError
        If a column of `OBJECT_FIELDS` is missing or the CRS is not understood; the message names the file.
    """
    target = Path(path)
    missing = [name for name in OBJECT_FIELDS if name not in inventory.objects]
    if missing:
        raise DataError(f"{target}: the inventory lacks the column {missing[0]!r}")
    try:
        crs = None if inventory.crs is None else CRS.from_user_input(inventory.crs)
    except CRSError as error:
        raise DataError(f"{target}: the coordinate reference system {inventory.crs!r} is not understood") from error
    table = inventory.objects[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)
    points = shapely.points(table[["x", "y", "z"]].to_numpy())
    temporary = target.with_name(f".{target.stem}-{uuid.uuid4().hex}.gpkg")
    before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": _FIXED_DATE})  # otherwise the file tells when it was written
    try:
        _write_layer(temporary, "objects", table, geometry=points, kind=_POINT, crs=crs)
        for layer, kind in LAYERS.items():
            mine = (table["kind"] == kind).to_numpy()
            shapes = footprints(table[mine]) if kind == "vehicle" else points[mine]
            shape = _POLYGON if kind == "vehicle" else _POINT
            _write_layer(temporary, layer, table[mine], geometry=shapes, kind=shape, crs=crs)
        if inventory.trajectory is not None:
            line = np.array([shapely.LineString(inventory.trajectory.xyz)])
            length = pd.DataFrame({"length": [round(inventory.trajectory.length, 3)]})
            _write_layer(temporary, "trajectory", length, geometry=line, kind=_LINE, crs=crs)
        os.replace(temporary, target)
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})
        temporary.unlink(missing_ok=True)


def read_geopackage(path: str | Path) -> RoadInventory:
    """Read back what `write_geopackage` wrote.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    RoadInventory
        Objects, CRS as WKT, and the path without times.

    Raises
    ------
    ReadError
        If the file is missing, is not a GeoPackage, or has no layer `objects`.
    """
    source = Path(path)
    if not source.is_file():
        raise ReadError(f"{source}: no such GeoPackage")
    try:
        layers = [str(name) for name in pyogrio.list_layers(source)[:, 0]]
    except pyogrio.errors.DataSourceError as error:
        raise ReadError(f"{source}: not a GeoPackage") from error
    if "objects" not in layers:
        raise ReadError(f"{source}: no layer 'objects' among {layers}")
    frame = gpd.read_file(source, layer="objects")
    objects = pd.DataFrame(frame.drop(columns="geometry"))[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)
    trajectory = None
    if "trajectory" in layers:
        line = gpd.read_file(source, layer="trajectory").geometry.iloc[0]
        trajectory = Trajectory.from_positions(shapely.get_coordinates(line, include_z=True), source=str(source))
    # An undefined CRS is read back as GDAL's engineering CRS of that name.
    known = frame.crs is not None and "Undefined" not in frame.crs.name
    return RoadInventory(objects, frame.crs.to_wkt() if known else None, trajectory)


class GeoPackageDataset(AbstractDataset[RoadInventory, RoadInventory]):
    """An inventory of road objects in a GeoPackage.

    Parameters
    ----------
    filepath : str
        The file.
    metadata : dict, optional
        Anything; not read.

    Examples
    --------
    In a catalog::

        inventory:
          type: mlsroad_pipeline.datasets.geopackage_dataset.GeoPackageDataset
          filepath: data/07_model_output/inventory.gpkg
    """

    def __init__(self, *, filepath: str, metadata: dict[str, Any] | None = None) -> None:
        self._filepath = Path(filepath)
        self.metadata = metadata

    def load(self) -> RoadInventory:
        """Read the inventory."""
        return read_geopackage(self._filepath)

    def save(self, data: RoadInventory) -> None:
        """Write the inventory, creating its folder."""
        self._filepath.parent.mkdir(parents=True, exist_ok=True)
        write_geopackage(data, self._filepath)

    def _exists(self) -> bool:
        return self._filepath.is_file()

    def _describe(self) -> dict[str, Any]:
        return {"filepath": str(self._filepath)}
