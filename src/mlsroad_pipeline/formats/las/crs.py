"""Coordinate reference systems of LAS files: WKT records and GeoTIFF keys."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.crs import crs_units, in_metres, is_same_crs, sidecar_crs
from mlsroad_pipeline.formats.files import log_once
from mlsroad_pipeline.formats.las.geotiff_keys import DIRECTORY, DOUBLES, TEXTS, GeotiffKeys, pack_directory
from mlsroad_pipeline.formats.las.header import WKT_BIT, LasHeader, Vlr

PROJECTION = b"LASF_Projection"
WKT = (PROJECTION, 2112)
KEYS = tuple((PROJECTION, key) for key in (DIRECTORY, DOUBLES, TEXTS))  # records of the GeoTIFF keys


def read_crs(header: LasHeader, path: Path | None = None) -> str | None:
    """Return the WKT of a file: of its WKT record, else of its GeoTIFF keys, else None; log for a path."""
    record = find_wkt(header)
    return _geotiff_wkt(header, path) if record is None else _text(record)


def find_wkt(header: LasHeader) -> Vlr | None:
    """Return the WKT record of a file: the first that PROJ can parse, else the first that is not empty."""
    records = _wkt_records(header)
    return next((record for record in records if crs_units(_text(record)) is not None), next(iter(records), None))


def _wkt_records(header: LasHeader) -> list[Vlr]:
    return [vlr for vlr in (*header.vlrs, *header.evlrs) if vlr.key == WKT and _text(vlr)]


def _text(record: Vlr) -> str:
    return record.data.split(b"\0")[0].decode("utf-8", "replace").strip()


def two_systems_note(header: LasHeader) -> str:
    """Return a sentence if the WKT records and the GeoTIFF keys of a file name different systems, else ""."""
    texts = {_text(vlr) for vlr in _wkt_records(header)}
    if len(texts) > 1:
        return f"it has {len(texts)} WKT records that differ: the first valid one is used; crs sets another"
    stated, keys = read_crs(header), _geotiff_wkt(header, None)
    if not texts or stated is None or keys is None or is_same_crs(stated, keys):
        return ""
    names = [text.partition('"')[2].partition('"')[0] for text in (stated, keys)]
    return f"its WKT record names {names[0]}, its GeoTIFF keys {names[1]}: the WKT is used; crs sets another"


def _geotiff_wkt(header: LasHeader, path: Path | None) -> str | None:
    """Return the system of the GeoTIFF keys; log keys that are not supported."""
    directory, doubles, texts = (header.find(key) for key in KEYS)
    if directory is None:
        return None
    values = [b"" if vlr is None else vlr.data for vlr in (doubles, texts)]
    try:
        return GeotiffKeys.parse(directory.data, *values).wkt()
    except DataError as error:  # the keys themselves stay in the file
        if path is not None:
            log_once(str(path), f"its GeoTIFF keys give no coordinate reference system: {error}; set crs")
        return None


def with_crs_of(
    header: LasHeader, cloud: PointCloud, path: Path, metres: NDArray[np.float64] | None = None
) -> LasHeader:
    """Set the system of a cloud in another file's header, where the two differ; ``metres`` are the file's factors."""
    stated = read_crs(header)
    factors = [1.0, 1.0] if metres is None else metres[1:].tolist()
    same = {stated, None if stated is None else in_metres(stated, *factors), sidecar_crs(Path(cloud.source))}
    if cloud.crs is None or cloud.crs in same:
        return header
    if header.minor >= 4:
        return with_wkt(header, cloud.crs)
    try:
        directory = pack_directory(cloud.crs)
    except DataError as error:
        raise DataError(
            f"{path}: the LAS 1.{header.minor} header of {cloud.source} states another coordinate reference system "
            f"than the points have, and cannot state theirs ({error}); write with like: none"
        ) from error
    kept = replace(header.without(*KEYS, WKT), evlrs=header.evlrs)
    return replace(kept, vlrs=(*kept.vlrs, Vlr(PROJECTION, DIRECTORY, directory, b"GeoTIFF GeoKeyDirectoryTag")))


def with_assigned_crs(header: LasHeader, crs: str) -> LasHeader:
    """Replace the system of a header of LAS 1.4 or above by another; coordinates are not transformed.

    The header is the same where it states this system; else it has WKT, and no GeoTIFF keys.
    """
    stated = read_crs(header)
    if stated is not None and is_same_crs(stated, crs):
        return header
    return with_wkt(header.without(*KEYS), crs)


def with_wkt(header: LasHeader, crs: str | None) -> LasHeader:
    """Add a WKT record and the WKT bit to a header of LAS 1.4 or above, if there is a system; GeoTIFF keys are kept."""
    if not crs:
        return header
    record = header.find(WKT)
    if record is None or _text(record) != crs.strip():
        header, new = header.without(WKT), Vlr(*WKT, crs.encode() + b"\0", b"OGC WKT")
        if len(new.data) <= 0xFFFF:
            header = replace(header, vlrs=(*header.vlrs, new))
        else:
            header = replace(header, evlrs=(*header.evlrs, new))
    return header.patched(encoding=header.integer("encoding") | WKT_BIT)
