"""Coordinate reference systems of LAS files: WKT records and GeoTIFF keys."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj

from mlsroad_pipeline.algorithms.exceptions import DataError
from mlsroad_pipeline.algorithms.point_cloud import PointCloud
from mlsroad_pipeline.datasets.formats.crs import sidecar_crs
from mlsroad_pipeline.datasets.formats.las_header import WKT_BIT, LasHeader
from mlsroad_pipeline.datasets.formats.las_vlr import Vlr

PROJECTION = b"LASF_Projection"
WKT = (PROJECTION, 2112)
GEOTIFF_KEYS = (PROJECTION, 34735)
PROJECTED_KEY, GEOGRAPHIC_KEY, VERTICAL_KEY = 3072, 2048, 4096
EPSG_CODES = range(1024, 32767)
"""Key values that are EPSG codes (OGC GeoTIFF 1.1, 7.5.1)."""


def read_crs(header: LasHeader) -> str | None:
    """Return the coordinate reference system of a file.

    Parameters
    ----------
    header : LasHeader
        The file's header.

    Returns
    -------
    str or None
        The WKT record's text where there is one; else the GeoTIFF keys as WKT where PROJ understands them.
    """
    record = header.find(WKT)
    if record is not None:
        text = record.data.split(b"\0")[0].decode("utf-8", "replace").strip()
        if text:
            return text
    keys = header.find(GEOTIFF_KEYS)
    return None if keys is None else _geotiff_wkt(keys.data)


def _geotiff_wkt(data: bytes) -> str | None:
    """Return the system that GeoTIFF keys name by EPSG code; keys that spell a system out are not understood."""
    words = np.frombuffer(data[: len(data) // 8 * 8], dtype="<u2").reshape(-1, 4)
    values = {int(key): int(value) for key, location, _, value in words[1:] if location == 0}
    codes = [values[key] for key in (PROJECTED_KEY, GEOGRAPHIC_KEY) if values.get(key, 0) in EPSG_CODES]
    if not codes:
        return None
    vertical = values.get(VERTICAL_KEY, 0)
    try:
        crs = pyproj.CRS.from_epsg(codes[0])
        if vertical in EPSG_CODES:
            name = f"{crs.name} + EPSG:{vertical}"
            crs = pyproj.crs.CompoundCRS(name, [crs, pyproj.CRS.from_epsg(vertical)])
    except pyproj.exceptions.CRSError:
        return None  # a code that PROJ does not know; the keys themselves stay in the file
    return str(crs.to_wkt())


def with_crs_of(header: LasHeader, cloud: PointCloud, path: Path) -> LasHeader:
    """Give another file's header the system of a cloud, where the two differ.

    Parameters
    ----------
    header : LasHeader
        The header to write.
    cloud : PointCloud
        The points.
    path : Path
        The file to write, for messages.

    Returns
    -------
    LasHeader
        The header; the same where the cloud has no system or that of the header.

    Raises
    ------
    DataError
        If the header's version cannot hold WKT and states another system.
    """
    stated = read_crs(header)
    if cloud.crs is None or cloud.crs == stated or cloud.crs == sidecar_crs(Path(cloud.source)):
        return header
    if header.minor >= 4:
        return with_wkt(header, cloud.crs)
    raise DataError(
        f"{path}: the LAS 1.{header.minor} header of {cloud.source} states another coordinate reference system than "
        "the points have; write with like: none"
    )


def with_wkt(header: LasHeader, crs: str | None) -> LasHeader:
    """Give a header a WKT record, as point formats 6 to 10 require.

    Parameters
    ----------
    header : LasHeader
        A header of version 1.4 or above.
    crs : str or None
        The system as WKT; None leaves the header as it is.

    Returns
    -------
    LasHeader
        The header with the record and the WKT bit. GeoTIFF keys that were there stay.
    """
    if not crs:
        return header
    record = header.find(WKT)
    if record is None or record.data.split(b"\0")[0].decode("utf-8", "replace").strip() != crs.strip():
        others = tuple(vlr for vlr in header.vlrs if vlr.key != WKT)
        text = crs.encode() + b"\0"
        extended = tuple(vlr for vlr in header.evlrs if vlr.key != WKT)
        if len(text) <= 0xFFFF:
            others = (*others, Vlr(PROJECTION, WKT[1], text, b"OGC WKT"))
        else:
            extended = (*extended, Vlr(PROJECTION, WKT[1], text, b"OGC WKT"))
        header = replace(header, vlrs=others, evlrs=extended)
    return header.patched(("H", 6, header.integer("H", 6) | WKT_BIT))
