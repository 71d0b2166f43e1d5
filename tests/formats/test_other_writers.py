"""Files of other libraries over the space of their formats and options, and ours read by these libraries."""

import tempfile
from pathlib import Path

import laspy
import numpy as np
import open3d as o3d
import plyfile
import pytest
from helpers.formats import make_labels
from helpers.las_rules import broken_rules
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.registry import format_of_name, get_format
from mlsroad_pipeline.label.writer import write_labelled

EXAMPLES = settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
DEFAULT = ReadOptions()
NAMES = st.text(st.characters(min_codepoint=97, max_codepoint=122), min_size=4, max_size=12)
TYPES = {
    "u1": "uint8",
    "i1": "int8",
    "u2": "uint16",
    "i2": "int16",
    "u4": "uint32",
    "i4": "int32",
    "f4": "f4",
    "f8": "f8",
}


def read(path):
    form = get_format(path)
    assert form.info(path, DEFAULT).n_points == len(form.read(path, DEFAULT))
    return form.read(path, DEFAULT)


@EXAMPLES
@given(data=st.data())
def test_las_of_laspy(data):
    version, point_format = data.draw(
        st.sampled_from([("1.1", 1), ("1.2", 0), ("1.2", 2), ("1.2", 3), ("1.3", 4), *[("1.4", k) for k in range(11)]])
    )
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = data.draw(st.sampled_from([[0.001] * 3, [0.01] * 3, [1e-7, 1e-7, 0.001], [0.25, 0.001, 1.0]]))
    header.offsets = data.draw(st.sampled_from([[0, 0, 0], [482_000, 5_455_000, 100], [-1e6, 5, 0]]))
    names = data.draw(st.lists(NAMES, unique=True, max_size=4))
    for name in names:
        kind = data.draw(st.sampled_from(["u1", "i2", "u4", "i8", "f4", "f8", "2u1", "3f4"]))
        scaled = {
            "scales": [0.5] * int(kind[0]) if kind[0] in "23" else [0.5],
            "offsets": [2.0] * (int(kind[0]) if kind[0] in "23" else 1),
        }
        header.add_extra_dim(
            laspy.ExtraBytesParams(name, kind, **(scaled if data.draw(st.booleans()) and "f" not in kind else {}))
        )
    n = data.draw(st.integers(1, 30))
    las = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(n, header=header))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    for name in las.points.array.dtype.names:
        column = las.points.array[name]
        raw = rng.integers(0, 256, column.nbytes, dtype=np.uint8).view(column.dtype.base).reshape(column.shape)
        column[...] = raw if column.dtype.base.kind != "f" else rng.normal(size=column.shape)
    if point_format in (9, 10):
        las.scanner_channel[:] = 1
    las.withheld[:] = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a.{data.draw(st.sampled_from(['las', 'laz']))}"
        las.write(str(path))
        was, cloud = laspy.read(path), read(path)
        np.testing.assert_allclose(cloud.world_xyz(), was.xyz, rtol=0, atol=1e-6)
        for name in names:
            np.testing.assert_allclose(cloud[name], np.asarray(was[name], dtype=np.float64), rtol=1e-12)
        write_labelled(path, Path(folder) / "out" / "a.laz", make_labels)
        assert broken_rules(Path(folder) / "out" / "a.laz") == []
        new = laspy.read(Path(folder) / "out" / "a.laz")
        for name in (*names, "intensity", "return_number", "point_source_id", "user_data", *"XYZ"):
            np.testing.assert_array_equal(new[name], was[name])


@EXAMPLES
@given(data=st.data())
def test_ply_of_plyfile(data):
    kinds = data.draw(st.lists(st.sampled_from(list(TYPES)), max_size=5))
    axes = data.draw(st.sampled_from(["f4", "f8"]))
    names = data.draw(st.lists(NAMES, unique=True, min_size=len(kinds), max_size=len(kinds)))
    n = data.draw(st.integers(1, 30))
    order = data.draw(st.permutations([*[(axis, axes) for axis in "xyz"], *zip(names, kinds, strict=True)]))
    rows = np.zeros(n, dtype=order)
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    for name, kind in order:
        limits = None if kind[0] == "f" else np.iinfo(kind)
        rows[name] = (
            rng.normal(size=n) if limits is None else rng.integers(limits.min, limits.max, n, dtype=kind, endpoint=True)
        )
    faces = np.array([([0, 0, 0],)], dtype=[("vertex_indices", "i4", (3,))])
    elements = [plyfile.PlyElement.describe(rows, "vertex"), plyfile.PlyElement.describe(faces, "face")]
    text, byte_order = data.draw(st.sampled_from([(True, "="), (False, "<"), (False, ">")]))
    elements = elements if data.draw(st.booleans()) else elements[::-1]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.ply"
        plyfile.PlyData(elements, text=text, byte_order=byte_order, comments=["by us"]).write(str(path))
        cloud = read(path)
        assert cloud.columns.keys() == set(names)
        for name, values in {**cloud.columns, **dict(zip("xyz", cloud.world_xyz().T, strict=True))}.items():
            np.testing.assert_allclose(values, rows[name], rtol=1e-6 if text else 0, atol=1e-9)


@EXAMPLES
@given(data=st.data())
def test_pcd_of_pypcd4(data):
    pypcd4 = pytest.importorskip("pypcd4")
    names = data.draw(st.lists(NAMES, unique=True, max_size=4))
    types = [np.float32] * 3 + [
        data.draw(st.sampled_from([np.float32, np.float64, np.uint8, np.int16, np.uint32])) for _ in names
    ]
    n = data.draw(st.integers(1, 30))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    values = [rng.integers(0, 200, n).astype(t) for t in types]
    encoding = data.draw(
        st.sampled_from([pypcd4.Encoding.ASCII, pypcd4.Encoding.BINARY, pypcd4.Encoding.BINARY_COMPRESSED])
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pcd"
        pypcd4.PointCloud.from_points(values, ("x", "y", "z", *names), types).save(path, encoding)
        cloud = read(path)
        np.testing.assert_array_equal(cloud.world_xyz(), np.stack(values[:3], axis=1))
        for name, column in zip(names, values[3:], strict=True):
            np.testing.assert_array_equal(cloud[name], column)
        ours = Path(folder) / "b.pcd"
        format_of_name(ours).write(ours, cloud, WriteOptions())
        back = pypcd4.PointCloud.from_path(ours)
        assert set(back.fields) == {"x", "y", "z", *names}
        np.testing.assert_array_equal(back.numpy(("x", "y", "z")), np.stack(values[:3], axis=1))


@EXAMPLES
@given(data=st.data())
def test_e57_of_pye57(data):
    pye57 = pytest.importorskip("pye57")
    n_scans, n = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 30))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    turned, coloured = data.draw(st.booleans()), data.draw(st.booleans())
    angle = rng.random() * 6
    rotation = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)]) if turned else np.array([1.0, 0, 0, 0])
    expected, intensities = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.e57"
        file = pye57.E57(str(path), mode="w")
        for k in range(n_scans):
            local, moved = rng.normal(size=(n, 3)) * 10, np.array([10.0 * k, 5.0, 0.0])
            intensities.append(rng.random(n))
            scan = {f"cartesian{axis}": local[:, i] for i, axis in enumerate("XYZ")} | {"intensity": intensities[-1]}
            if coloured:
                scan |= {f"color{name}": rng.integers(0, 256, n).astype(np.uint8) for name in ("Red", "Green", "Blue")}
            file.write_scan_raw(scan, rotation=rotation, translation=moved)
            c, s = np.cos(angle), np.sin(angle)
            matrix = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) if turned else np.eye(3)
            expected.append(local @ matrix.T + moved)
        file.close()
        cloud = read(path)
        np.testing.assert_allclose(cloud.world_xyz(), np.concatenate(expected), atol=1e-4)
        assert ("rgb" in cloud) == coloured
        assert cloud["intensity"].min() >= 0 and cloud["intensity"].max() <= 1
        ours = Path(folder) / "b.e57"
        format_of_name(ours).write(ours, cloud, WriteOptions())
        back = pye57.E57(str(ours))
        got = back.read_scan_raw(0, ignore_unsupported_fields=True)
        np.testing.assert_allclose(got["cartesianX"], cloud.world_xyz()[:, 0], atol=1e-9)
        back.close()


@pytest.mark.parametrize("extension", ["ply", "pcd", "xyz", "pts"])
@EXAMPLES
@given(data=st.data())
def test_clouds_of_open3d(extension, data):
    n = data.draw(st.integers(1, 30))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(rng.normal(size=(n, 3)) * 20))
    coloured = data.draw(st.booleans()) and extension in ("ply", "pcd")
    if coloured:
        cloud.colors = o3d.utility.Vector3dVector(rng.integers(0, 256, (n, 3)) / 255)
    if data.draw(st.booleans()) and extension != "pts":
        cloud.normals = o3d.utility.Vector3dVector(rng.normal(size=(n, 3)))
    ascii_, compressed = data.draw(st.booleans()), data.draw(st.booleans())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a.{extension}"
        assert o3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)
        back = read(path)
        np.testing.assert_allclose(back.world_xyz(), np.asarray(cloud.points), rtol=1e-5, atol=1e-5)
        if coloured:
            np.testing.assert_allclose(back["rgb"], np.asarray(cloud.colors) * 255, atol=1)
        ours = Path(folder) / "b.ply"
        format_of_name(ours).write(ours, PointCloud(back.xyz, {}, back.origin, None, str(ours)), WriteOptions())
        np.testing.assert_allclose(np.asarray(o3d.io.read_point_cloud(str(ours)).points), back.world_xyz(), atol=1e-9)
