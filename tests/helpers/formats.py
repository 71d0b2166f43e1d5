"""Files of every layout made by other libraries, and slow, obvious readers to compare with."""

from __future__ import annotations

import gzip
from pathlib import Path

import laspy
import numpy as np
from laspy.vlrs.vlr import VLR
from laspy.vlrs.vlrlist import VLRList

UTM = (482_000.0, 5_455_000.0, 100.0)
LAYOUTS = [
    *[("1.1", pf) for pf in (0, 1)],
    *[("1.2", pf) for pf in (2, 3)],
    *[("1.3", pf) for pf in (4, 5)],
    *[("1.4", pf) for pf in (0, 3, 6, 7, 8, 9, 10)],
]
SCALED = {"scales": [0.25], "offsets": [-3.0]}


def make_las(
    path: Path, rng, *, version="1.4", point_format=7, n=300, extras=True, geotiff=None, scale=0.001, channels=False
):
    """Write a LAS or LAZ with laspy, every dimension random over its whole range, and return laspy's view of it."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.full(3, scale), np.array(UTM)
    header.system_identifier, header.generating_software = "van 7", "maker 1.2"
    header.creation_date = header.creation_date.replace(year=2019, month=3, day=5)
    header.file_source_id, header.global_encoding.gps_time_type = 42, laspy.header.GpsTimeType.STANDARD
    if extras:
        header.add_extra_dims(
            [
                laspy.ExtraBytesParams("ring", "u1", description="laser"),
                laspy.ExtraBytesParams("deviation", "i2", **SCALED),
                laspy.ExtraBytesParams("normal", "3f4"),
                laspy.ExtraBytesParams("height", "f8", no_data=[-99.0]),
            ]
        )
    header.vlrs.append(VLR("maker", 77, "calibration", b"\x00\x01binary\xff"))
    header.vlrs.append(VLR("LASF_Spec", 0, "classes", b"\x02ground_(bare)!!" + b"\x03" + b"low\0" * 3 + b"abc"))
    if geotiff is not None:
        words = np.array([1, 1, 0, 1, 3072, 0, 1, geotiff], dtype="<u2")
        header.vlrs.append(VLR("LASF_Projection", 34735, "keys", words.tobytes()))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(n, header=header)
    for name in las.points.array.dtype.names:
        column = las.points.array[name]
        if column.dtype.kind == "f" or column.dtype.base.kind == "f":
            column[...] = rng.normal(size=column.shape)
        elif name in ("X", "Y", "Z"):
            column[...] = rng.integers(-90_000, 90_000, n)
        else:
            limits = np.iinfo(column.dtype)
            column[...] = rng.integers(limits.min, limits.max, column.shape, dtype=column.dtype.base, endpoint=True)
    if point_format in (9, 10) and not channels:
        las.scanner_channel[:] = 2
    if version == "1.4":
        las.evlrs = VLRList([VLR("maker", 78, "long", bytes(range(256)) * 300)])
    las.write(str(path))
    return laspy.read(str(path))


def las_column(las, name: str) -> np.ndarray:
    """Return a dimension as laspy gives it, in memory of its own."""
    return np.array(las[name])


def make_labels(start: int, stop: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give each row a class, a confidence and an object that depend on the row alone."""
    rows = np.arange(start, stop)
    objects = np.where(rows % 3, rows * 40_503 % 2**32, 0)
    return (rows * 7 % 256).astype(np.uint8), (rows % 97 / 97).astype(np.float32), objects.astype(np.uint32)


def read_text_slowly(path: Path, delimiter: str | None, skip: int) -> np.ndarray:
    """Parse a text table with nothing but split and float."""
    data = path.read_bytes()
    lines = (gzip.decompress(data) if path.suffix == ".gz" else data).decode().splitlines()[skip:]
    return np.array([[float(value) for value in line.split(delimiter)] for line in lines if line.strip()])


def raw_vlrs(path: Path) -> list[tuple[bytes, int, bytes, bytes]]:
    """Return user id, record id, description and data of the records, straight from the bytes."""
    data = path.read_bytes()
    at, found = int.from_bytes(data[94:96], "little"), []
    for _ in range(int.from_bytes(data[100:104], "little")):
        size = int.from_bytes(data[at + 20 : at + 22], "little")
        body = data[at + 54 : at + 54 + size]
        found.append(
            (data[at + 2 : at + 18], int.from_bytes(data[at + 18 : at + 20], "little"), data[at + 22 : at + 54], body)
        )
        at += 54 + size
    return found


def check_written_labels(las):
    """Hold the labels of a labelled file against those that were given."""
    codes, confidence, objects = make_labels(0, len(las))
    np.testing.assert_array_equal(las.classification, codes)
    np.testing.assert_array_equal(las["confidence"], confidence)
    np.testing.assert_array_equal(las["object_id"], objects)
    assert (las["confidence"].dtype, las["object_id"].dtype) == (np.float32, np.uint32)
