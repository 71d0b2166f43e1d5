"""Round trips of generated clouds through every format that is written."""

import tempfile
from pathlib import Path

import laspy
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from laspy.vlrs.vlrlist import VLRList

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.formats.registry import format_of_name, get_format

EXAMPLES = settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
INTEGERS = ("i1", "u1", "i2", "u2", "i4", "u4", "i8")
RESOLUTION = {"laz": 5.1e-4, "las": 5.1e-4, "copc.laz": 5.1e-4, "csv": 5.1e-5, "txt.gz": 5.1e-5}
"""Half a step of the written coordinates; other formats hold them exactly."""

NO_LONG_INTEGERS = ("csv", "txt.gz", "ply")
"""Formats that lose 64-bit integers above 2^53: text is parsed as float64, PLY has no such type."""


@st.composite
def clouds(draw, with_long):
    """Return a cloud near or far, with columns of any type; a first column tells the points apart."""
    n = draw(st.integers(1, 40))
    xyz = np.round(draw(arrays(np.float64, (n, 3), elements=st.floats(-900, 900))), 3)
    origin = np.array(draw(st.sampled_from([(0.0, 0.0, 0.0), (480_000.0, 5_455_000.0, 0.0)])))
    columns = {"number": np.arange(n, dtype=np.int32)}
    for k, kind in enumerate(draw(st.lists(st.sampled_from(INTEGERS[: None if with_long else -1]), max_size=4))):
        limits = np.iinfo(kind)
        values = draw(arrays(kind, n, elements=st.integers(int(limits.min), int(limits.max))))
        columns[f"whole_{k}"] = values
    for k, width in enumerate(draw(st.lists(st.sampled_from([32, 64]), max_size=2))):
        columns[f"real_{k}"] = draw(arrays(f"f{width // 8}", n, elements=st.floats(-1e6, 1e6, width=width)))
    if draw(st.booleans()):
        columns["rgb"] = draw(arrays("u1", (n, 3)))
    if draw(st.booleans()):
        columns["gps_time"] = draw(arrays("f8", n, elements=st.floats(0, 1e9)))
    crs = parse_crs("EPSG:25832") if draw(st.booleans()) else None
    return PointCloud(xyz, columns, origin, crs)


@pytest.mark.parametrize(
    "extension", ["laz", "las", "copc.laz", "ply", "pcd", "e57", "csv", "txt.gz", "parquet", "npz"]
)
def test_generated_clouds_come_back(extension):
    @EXAMPLES
    @given(cloud=clouds(with_long=extension not in NO_LONG_INTEGERS))
    def round_trip(cloud):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"cloud.{extension}"
            format_of_name(path).write(path, cloud, WriteOptions(like="none"))
            back = get_format(path).read(path, ReadOptions())
        order = np.argsort(back["number"], kind="stable")  # COPC has an order of its own
        assert len(back) == len(cloud)
        difference = np.abs(back.world_xyz()[order] - cloud.world_xyz()).max()
        near = not cloud.origin.any()
        exact = 4e-5 if extension == "pcd" and near else 1e-9  # float32 below 1 km
        assert difference <= RESOLUTION.get(extension, exact)
        for name, values in cloud.columns.items():
            found = back[name][order]  # text is read as float64, and gives any narrower float back by rounding
            found = found.astype(values.dtype) if values.dtype.kind == "f" else found
            np.testing.assert_array_equal(found, values, err_msg=f"{extension}: {name}")
        assert back.crs == cloud.crs

    round_trip()


LAYOUTS = [
    *[("1.1", number) for number in (0, 1)],
    *[("1.2", number) for number in (0, 1, 2, 3)],
    *[("1.3", number) for number in range(6)],
    *[("1.4", number) for number in range(11)],
]
EXTRAS = [f"{count}{kind}" for count in ("", "2", "3") for kind in ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8")]
EXTRAS += [f"{count}{kind}" for count in ("", "2", "3") for kind in ("f4", "f8")]
RECORDS = st.lists(st.tuples(st.integers(0, 65_535), st.binary(max_size=300)), max_size=4)


def described(number, kind, scaled):
    """Describe an extra dimension, stored as it stands or in steps."""
    count = int(kind[0]) if kind[0].isdigit() else 1
    steps = {"scales": [0.25] * count, "offsets": [-3.0] * count} if scaled and "f" not in kind else {}
    return laspy.ExtraBytesParams(f"extra_{number}", kind, description=f"number {number}", **steps)


def fill(array, rng, point_format):
    """Put random values over the whole range of their type into every field but those that lazrs cannot vary."""
    for name in array.dtype.names:
        column = array[name]
        kind = column.dtype.base
        if name in ("X", "Y", "Z"):
            column[...] = rng.integers(-90_000, 90_000, len(array))
        elif kind.kind == "f":
            column[...] = np.round(rng.normal(size=column.shape) * 100, 2)
        elif name.startswith("extra_") and kind.itemsize == 8:  # scaled ones are read as float64
            column[...] = rng.integers(0, 2**50, column.shape, dtype=kind)
        else:
            limits = np.iinfo(kind)
            column[...] = rng.integers(limits.min, limits.max, column.shape, dtype=kind, endpoint=True)
    if point_format in (9, 10):
        array["classification_flags"][...] &= 0xCF  # one scanner channel: packets of several are refused


@settings(EXAMPLES, max_examples=30)
@given(
    layout=st.sampled_from(LAYOUTS),
    scale=st.sampled_from([1e-4, 0.001, 0.01, 0.25]),
    extras=st.lists(st.tuples(st.sampled_from(EXTRAS), st.booleans()), max_size=4),
    records=RECORDS,
    extended=RECORDS,
    compressed=st.booleans(),
)
def test_generated_headers_come_back_byte_for_byte(layout, scale, extras, records, extended, compressed):
    version, point_format = layout
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.full(3, scale), np.array([480_000.0, 5_455_000.0, 0.0])
    header.add_extra_dims([described(i, kind, scaled) for i, (kind, scaled) in enumerate(extras)])
    for number, data in records:
        header.vlrs.append(laspy.VLR("somebody", number, "a record", data))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(30, header=header)
    fill(las.points.array, np.random.default_rng(len(records)), point_format)
    if version == "1.4":
        las.evlrs = VLRList([laspy.VLR("somebody", number, "a long record", data * 300) for number, data in extended])
    with tempfile.TemporaryDirectory() as folder:
        path, again = Path(folder) / "a.las", Path(folder) / "b.las"
        las.write(path)
        cloud = get_format(path).read(path, ReadOptions())
        if compressed:
            middle = Path(folder) / "c.laz"
            format_of_name(middle).write(middle, cloud, WriteOptions())
            cloud = get_format(middle).read(middle, ReadOptions())
        format_of_name(again).write(again, cloud, WriteOptions())
        assert again.read_bytes() == path.read_bytes()
