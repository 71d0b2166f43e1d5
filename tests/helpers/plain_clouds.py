"""Clouds of given coordinates and columns in any format, written by this package."""

from pathlib import Path

import numpy as np
import pyproj

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.registry import format_of_name


def write(path: Path, xyz, crs=None, **columns) -> Path:
    """Write a cloud in the format of the name, in a folder that is made if needed, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    wkt = None if crs is None else pyproj.CRS.from_user_input(crs).to_wkt()
    cloud = PointCloud(np.asarray(xyz, float), columns, np.zeros(3), wkt, str(path))
    format_of_name(path).write(path, cloud, WriteOptions(like="none"))
    return path
