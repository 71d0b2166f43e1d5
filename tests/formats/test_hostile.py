"""Small files that state or unpack to huge clouds are refused at once; points that no header counts are reported."""

import gzip
import io
import struct
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.formats import make_las

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.e57.pages import CONTENT, PAGE, SIGNATURE, pack_pages
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.registry import format_of_name, get_format

DEFAULT = ReadOptions()
NAMESPACE = "http://www.astm.org/COMMIT/E57/2010-e57-v1.0"
CLOUD = PointCloud(np.random.default_rng(0).normal(size=(50, 3)) * 9)
MIB_64 = bytes(1 << 26)


def physical(at):
    return at // CONTENT * PAGE + at % CONTENT


def e57_of_nothing(path, n_points):
    """Write one scan whose fields take no bits, so that its packets bound no number of points."""
    fields = "".join(f'<cartesian{a} type="Integer" minimum="1" maximum="1"/>' for a in "XYZ")
    fields += '<cartesianInvalidState type="Integer" minimum="0" maximum="0"/>'
    points = f'<points type="CompressedVector" fileOffset="48" recordCount="{n_points}"><prototype>{fields}</prototype>'
    xml = f'<e57Root xmlns="{NAMESPACE}"><data3D><vectorChild>{points}</points></vectorChild></data3D></e57Root>'
    body = struct.pack("<B7xQQQ", 1, 32, physical(80), 0) + xml.encode()
    n_pages = -(-(48 + len(body)) // CONTENT)
    head = struct.pack("<8sIIQQQQ", SIGNATURE, 1, 0, n_pages * PAGE, physical(80), len(xml), PAGE)
    path.write_bytes(pack_pages(head + body).tobytes())


def npz_of_zeros(path):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": ((5 << 26) // 24, 3)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xyz.npy", "w") as entry:
        entry.write(head.getvalue())
        for _ in range(5):
            entry.write(MIB_64)


def gzip_of_zeros(path):
    with gzip.open(path, "wb", compresslevel=1) as stream:
        stream.write(b"# .PCD v0.7\n")
        for _ in range(5):
            stream.write(MIB_64)


def parquet_of_zeros(path):
    values = pa.array(np.zeros(12_000_000))
    pq.write_table(pa.table(dict.fromkeys("xyz", values)), path, compression="zstd")


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        (
            "a.e57",
            lambda path: e57_of_nothing(path, 1 << 40),
            r"it states 1099511627776 points in a file of 1020 bytes",
        ),
        ("a.npz", npz_of_zeros, r"its \d+ bytes would become 335544\d+ or more"),
        ("a.pcd.gz", gzip_of_zeros, r"its \d+ bytes would become \d+ or more"),
        ("a.parquet", parquet_of_zeros, r"its \d+ bytes would become 288000000 or more"),
    ],
)
def test_files_that_fill_the_memory_are_refused(tmp_path, name, make, message):
    path = tmp_path / name
    make(path)
    with pytest.raises(ReadError, match=rf"{name.replace('.', '[.]')} is damaged.*{message}"):
        get_format(path).info(path, DEFAULT)


def ply(path, lines, data=b"", encoding="binary_little_endian"):
    path.write_bytes("\n".join(["ply", f"format {encoding} 1.0", *lines, "end_header", ""]).encode() + data)
    return path


FACES = ["element face {}", "property list uchar int corners"]
VERTICES = ["element vertex {}", *(f"property float {axis}" for axis in "xyz")]


def test_a_ply_of_empty_lists_is_walked_over(tmp_path):
    n = 3_000_000  # as objects of Python, 300 MB
    lines = [FACES[0].format(n), FACES[1], VERTICES[0].format(2), *VERTICES[1:]]
    xyz = np.arange(6, dtype="<f4")
    path = ply(tmp_path / "a.ply", lines, bytes(n) + xyz.tobytes())
    np.testing.assert_array_equal(get_format(path).read(path, DEFAULT).world_xyz(), xyz.reshape(2, 3))
    path = ply(tmp_path / "b.ply", [FACES[0].format(10**9), *lines[1:]], bytes(n))
    with pytest.raises(ReadError, match=r"b\.ply .* 1000000000 .*'face'"):
        get_format(path).read(path, DEFAULT)


@pytest.mark.parametrize("sizes", ["char", "uchar", "short", "int", "uint"])
def test_lists_that_leave_the_file_are_damage(tmp_path, sizes):
    lines = [FACES[0].format(1), f"property list {sizes} double corners", VERTICES[0].format(1), *VERTICES[1:]]
    path = ply(tmp_path / "a.ply", lines, b"\xff" * 30)
    with pytest.raises(ReadError, match=r"a\.ply .* 1 records of 'face'"):
        get_format(path).read(path, DEFAULT)


def longer(path):
    """Write 50 points, or 5 rows of text, and bytes behind them; return the notes of the reader."""
    head = "# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 5\nHEIGHT 1\nDATA ascii\n"
    rows = "1 2 3\n" * 7
    if path.name == "b.ply":
        ply(path, [VERTICES[0].format(5), *VERTICES[1:]], rows.encode(), "ascii")
    elif path.name == "b.pcd":
        path.write_text(head + rows)
    else:
        format_of_name(path).write(path, CLOUD, WriteOptions())
        data = path.read_bytes()
        if path.suffix == ".e57":
            content = b"".join(data[i : i + CONTENT] for i in range(0, len(data), PAGE))
            path.write_bytes(pack_pages(content.replace(b'recordCount="50"', b'recordCount="30"')).tobytes())
            return "scan 0 states 30 points, its packets hold 20 more: they are not read"
        path.write_bytes(data + bytes(24))
        return "its header states 50 points, 24 more bytes follow: they are not read"
    return "its header states 5 points, 2 more rows follow: they are not read"


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "b.ply", "b.pcd", "a.e57"])
def test_points_behind_the_stated_ones_are_told(tmp_path, name):
    told = longer(tmp_path / name)
    assert told in get_format(tmp_path / name).info(tmp_path / name, DEFAULT).notes


@pytest.mark.parametrize(("stated", "told"), [(59_990, True), (5, True), (60_001, False)])
def test_points_that_the_last_chunk_of_an_old_laz_has_are_read(tmp_path, rng, stated, told):
    path = tmp_path / "a.laz"
    make_las(path, rng, version="1.2", point_format=1, n=60_001, extras=False)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 107, stated)
    path.write_bytes(data)
    info = LasFormat().info(path, DEFAULT)
    assert info.n_points == 60_001
    assert info.notes == (f"its header states {stated} points, it holds 60001: all are read",) * told


@pytest.mark.parametrize("tail", [b"by us, 2024 " * 7, bytes(range(256)) * 7, b"\xff" * 280])
def test_bytes_after_no_points_are_no_points(tmp_path, rng, tail):
    path = tmp_path / "a.las"
    make_las(path, rng, version="1.2", point_format=1, n=0, extras=False)
    path.write_bytes(path.read_bytes() + tail[: len(tail) // 28 * 28])
    info = LasFormat().info(path, DEFAULT)
    assert info.n_points == 0
    assert f"{len(tail) // 28 * 28} bytes after its 0 points are no points: not read" in info.notes
