"""Rasters as GeoTIFF (OGC 19-008), without GDAL."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, TiffImagePlugin
from pyproj import CRS

from mlsroad_pipeline.formats.files import write_atomic

_SCALE, _TIE, _KEYS, _NO_DATA = 33550, 33922, 34735, 42113  # tags
_MODEL, _RASTER, _PROJECTED = 1024, 1025, 3072  # keys
_USER_DEFINED = 32767


def write_geotiff(
    values: NDArray[np.float32], path: Path, *, corner: tuple[float, float], edge: float, crs: str | None
) -> None:
    """Write a raster whose rows go from north to south, whole or not at all.

    `corner` is the north-western corner of the first cell. Systems without an EPSG code are written as user-defined.
    """
    code = None if crs is None else CRS.from_user_input(crs).to_epsg()
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[_SCALE], tags.tagtype[_SCALE] = (edge, edge, 0.0), 12
    tags[_TIE], tags.tagtype[_TIE] = (0.0, 0.0, 0.0, *corner, 0.0), 12
    keys = [(_MODEL, 1), (_RASTER, 1), (_PROJECTED, code or _USER_DEFINED)]
    tags[_KEYS] = (1, 1, 0, len(keys), *(number for key, value in keys for number in (key, 0, 1, value)))
    tags.tagtype[_KEYS] = 3
    tags[_NO_DATA], tags.tagtype[_NO_DATA] = "nan", 2
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(values, dtype=np.float32)).save(
        buffer, format="TIFF", tiffinfo=tags, compression="tiff_adobe_deflate"
    )
    write_atomic(path, buffer.getvalue())
