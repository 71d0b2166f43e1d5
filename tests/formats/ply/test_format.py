"""PLY against plyfile."""

import numpy as np
import plyfile
import pyproj
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.ply.format import PlyFormat

PLY = PlyFormat()
DEFAULT = ReadOptions()
FIELDS = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
FIELDS += [("scalar_Intensity", "u2"), ("ring", "i1"), ("semantic", "i4"), ("curvature", "f4")]


def make_vertices(rng, n=200, kind="f8"):
    table = np.zeros(n, dtype=[(name, kind if name in "xyz" else form) for name, form in FIELDS])
    for name, form in FIELDS:
        table[name] = rng.integers(0, 100, n) if form[0] != "f" else rng.normal(size=n) * 50
    if kind == "f8":
        table["x"] += 482_000
    return table


def write_ply(path, vertices, *, text=False, order="<", faces="after"):
    corner = np.array([([0, 1, 2],), ([1, 2, 3, 4],)], dtype=[("vertex_indices", "O")])
    elements = [plyfile.PlyElement.describe(vertices, "vertex", comments=["scan 3"])]
    elements.insert(0 if faces == "before" else 1, plyfile.PlyElement.describe(corner, "face"))
    plyfile.PlyData(elements, text=text, byte_order="=" if text else order).write(path)


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("faces", ["before", "after"])
@pytest.mark.parametrize("encoding", [(True, "="), (False, "<"), (False, ">")])
def test_all_encodings(tmp_path, rng, encoding, kind, faces):
    text, order = encoding
    path, table = tmp_path / "a.ply", make_vertices(rng, kind=kind)
    write_ply(path, table, text=text, order=order, faces=faces)
    cloud = PLY.read(path, DEFAULT)
    expected = np.stack([table[name] for name in "xyz"], axis=1).astype(np.float64)
    np.testing.assert_allclose(cloud.world_xyz(), expected, rtol=1e-7 if text else 0, atol=1e-9)
    np.testing.assert_array_equal(cloud["rgb"], np.stack([table["red"], table["green"], table["blue"]], axis=1))
    np.testing.assert_array_equal(cloud["intensity"], (table["scalar_Intensity"] / 65535).astype(np.float32))
    np.testing.assert_array_equal(cloud["label"], table["semantic"])
    np.testing.assert_allclose(cloud["curvature"], table["curvature"], rtol=1e-6)
    assert (cloud["ring"].dtype, cloud["label"].dtype, cloud["curvature"].dtype) == (np.int8, np.int32, np.float32)
    near = [np.floor(table["x"][0] / 100) * 100, np.floor(table["y"][0] / 100) * 100, 0] if kind == "f8" else [0, 0, 0]
    np.testing.assert_array_equal(cloud.origin, near)
    part = PLY.read(path, DEFAULT, start=37, stop=190)
    np.testing.assert_array_equal(part.xyz, cloud.xyz[37:190])
    np.testing.assert_array_equal(part.origin, cloud.origin)
    np.testing.assert_array_equal(part["label"], cloud["label"][37:190])
    info = PLY.info(path, DEFAULT)
    assert info.n_points == 200
    assert dict(info.columns) == {name: values.dtype for name, values in cloud.columns.items()}


def test_list_properties_of_vertices_are_left_out(tmp_path, rng):
    table = np.zeros(3, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("faces", "O")])
    table["x"] = [1, 2, 3]
    table["faces"] = [[1], [1, 2], []]
    element = plyfile.PlyElement.describe(table, "vertex", val_types={"faces": "i4"})
    plyfile.PlyData([element]).write(tmp_path / "a.ply")
    cloud = PLY.read(tmp_path / "a.ply", DEFAULT)
    assert cloud.xyz[:, 0].tolist() == [1, 2, 3]
    assert not cloud.columns


def test_float_colours_and_intensities(tmp_path, rng):
    fields = [(name, "f4") for name in ("x", "y", "z", "r", "g", "b", "intensity")]
    table = np.zeros(9, dtype=fields)
    levels = np.arange(9) * 30
    for name in "rgb":
        table[name] = levels / 255
    table["intensity"] = np.arange(9) * 250
    write_ply(tmp_path / "a.ply", table)
    cloud = PLY.read(tmp_path / "a.ply", DEFAULT)
    np.testing.assert_array_equal(cloud["rgb"], np.repeat(levels[:, None], 3, axis=1))
    np.testing.assert_allclose(cloud["intensity"], table["intensity"] / 65535, rtol=1e-6)
    np.testing.assert_array_equal(PLY.read(tmp_path / "a.ply", DEFAULT, stop=2)["intensity"], cloud["intensity"][:2])


def test_written_and_read_back(tmp_path, rng):
    crs = pyproj.CRS(25832).to_wkt()
    columns = {
        "rgb": rng.integers(0, 256, (40, 3)).astype(np.uint8),
        "intensity": rng.random(40).astype(np.float32),
        "gps_time": rng.random(40),
        "label": rng.integers(0, 90, 40).astype(np.uint8),
        "big": rng.integers(0, 2**40, 40),
    }
    cloud = PointCloud(rng.random((40, 3)), columns, np.array([482_000.0, 5_455_000.0, 0]), crs)
    PLY.write(tmp_path / "a.ply", cloud, WriteOptions())
    back = PLY.read(tmp_path / "a.ply", DEFAULT)
    np.testing.assert_array_equal(back.world_xyz(), cloud.world_xyz())
    for name, values in columns.items():
        np.testing.assert_array_equal(back[name], values)
    assert back.crs == crs
    assert plyfile.PlyData.read(tmp_path / "a.ply")["vertex"].count == 40


@pytest.mark.parametrize("n", [0, 1])
@pytest.mark.parametrize("text", [True, False])
def test_no_point_and_one_point(tmp_path, rng, n, text):
    write_ply(tmp_path / "a.ply", make_vertices(rng, n), text=text)
    cloud = PLY.read(tmp_path / "a.ply", DEFAULT)
    assert (len(cloud), PLY.info(tmp_path / "a.ply", DEFAULT).n_points) == (n, n)
    assert cloud["rgb"].shape == (n, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"plx\n", r"is not a PLY file"),
        (b"ply\nformat ascii 1.0\n", r"is truncated: its PLY header has no end_header"),
        (b"ply\nformat ascii 1.0\nend_header", r"nothing follows its PLY header"),
        (b"ply\nformat middle 1.0\nelement vertex 1\nend_header\n", r"has PLY format 'middle'"),
        (b"ply\nformat ascii 1.0\nelement face 1\nend_header\n", r"no element 'vertex' \(elements: face\)"),
        (b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", r"line 3: not understood: 'element vertex many'"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\nend_header\n", r"line 4: not understood"),
    ],
)
def test_bad_headers(tmp_path, text, message):
    (tmp_path / "bad.ply").write_bytes(text)
    with pytest.raises(ReadError, match=r"bad\.ply.*" + message):
        PLY.info(tmp_path / "bad.ply", DEFAULT)


def test_truncated_and_wrong_values(tmp_path, rng):
    path = tmp_path / "cut.ply"
    write_ply(path, make_vertices(rng)[list(n for n, _ in FIELDS)], faces="after")
    data = path.read_bytes()
    begin = data.index(b"end_header\n") + 11
    path.write_bytes(data[: begin + 42 * 5 + 3])
    with pytest.raises(ReadError, match=r"cut\.ply .* 200 points.* 5$"):
        PLY.read(path, DEFAULT)
    head = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {n}\n" for n in "xyz")
    path.write_text(head + "end_header\n1 2 3\n4 5 6\n")
    with pytest.raises(ReadError, match=r"cut\.ply .* 3 points.* 2$"):
        PLY.read(path, DEFAULT)
    path.write_text(head + "end_header\n1 2 3\n4 5\n7 8 9\n")
    with pytest.raises(ReadError, match=r"cut\.ply, line 9: .*'4 5'"):
        PLY.read(path, DEFAULT)
    path.write_text(head + "end_header\n1 2 3\n4 nan 6\n7 8 inf\n")
    with pytest.raises(DataError, match=r"cut\.ply: 2 points .* row 1:"):
        PLY.read(path, DEFAULT)
    path.write_text(head + "property uchar label\nend_header\n1 2 3 1\n4 5 6 256\n7 8 9 1\n")
    with pytest.raises(ReadError, match=r"'label' .*256\.0.* uint8"):
        PLY.read(path, DEFAULT)
    path.write_text(head.replace("property float z\n", "") + "end_header\n1 2\n4 5\n7 8\n")
    with pytest.raises(MissingColumnError, match=r"cut\.ply .*'z' \(.*: x, y\)"):
        PLY.read(path, DEFAULT)
