"""Gzip of every format that is read so: as the plain file, by its content, in bounded memory."""

import errno
import gzip
import io
import shutil
import tracemalloc

import numpy as np
import pytest
from helpers.formats import make_labels, make_las

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats import files
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.crs import parse_crs
from mlsroad_pipeline.formats.files import Content, first_bytes, open_content
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.ply.format import PlyFormat
from mlsroad_pipeline.formats.registry import format_of_name, get_format
from mlsroad_pipeline.label.writer import write_labelled

DEFAULT = ReadOptions()
UTM = parse_crs("EPSG:25832")


def make_cloud(rng, n=500):
    columns = {
        **{"rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8), "intensity": rng.random(n).astype(np.float32)},
        "gps_time": rng.random(n) * 1e6,
    }
    return PointCloud(rng.random((n, 3)) * 50, columns, np.array([482_000.0, 5_455_000.0, 0.0]), UTM)


def ascii_ply(cloud, *, faces_first=False):
    rows = "\n".join(" ".join(map(repr, row)) for row in cloud.world_xyz().tolist())
    vertex = f"element vertex {len(cloud)}\nproperty double x\nproperty double y\nproperty double z\n"
    face = "element face 1\nproperty list uchar int vertex_indices\n"
    head, body = (face + vertex, "3 0 1 2\n" + rows) if faces_first else (vertex + face, rows + "\n3 0 1 2")
    return f"ply\nformat ascii 1.0\n{head}end_header\n{body}\n".encode()


def pcd(cloud, encoding):
    xyz = np.ascontiguousarray(cloud.xyz, "<f4")
    head = f"# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {len(xyz)}\nHEIGHT 1\nDATA {encoding}\n".encode()
    if encoding == "ascii":
        return head + "\n".join(" ".join(map(repr, row)) for row in xyz.tolist()).encode()
    data = xyz.T.tobytes()
    packed = b"".join(bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32] for i in range(0, len(data), 32))
    sizes = np.array([len(packed), len(data)], "<u4").tobytes()
    return head + sizes + packed


def make_plain(path, kind, rng):
    cloud = make_cloud(rng)
    if kind in ("las", "laz"):
        make_las(path, rng, n=500, geotiff=25832)
    elif kind in ("ascii.ply", "faces.ply"):
        path.write_bytes(ascii_ply(cloud, faces_first=kind == "faces.ply"))
    elif kind in ("ascii.pcd", "binary_compressed.pcd"):
        path.write_bytes(pcd(cloud, kind.removesuffix(".pcd")))
    else:
        format_of_name(path).write(path, cloud, WriteOptions(like="none"))


@pytest.mark.parametrize(
    "kind",
    ["ply", "ascii.ply", "faces.ply", "pcd", "ascii.pcd", "binary_compressed.pcd", "las", "laz", "copc.laz", "e57"],
)
def test_packed_files_are_read_like_plain_ones(tmp_path, rng, kind):
    plain, packed, nameless = tmp_path / f"a.{kind}", tmp_path / f"a.{kind}.GZ", tmp_path / "points"
    make_plain(plain, kind, rng)
    if (tmp_path / "a.prj").exists():
        shutil.copy(tmp_path / "a.prj", tmp_path / "points.prj")
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    shutil.copy(packed, nameless)
    form = get_format(plain)
    assert get_format(packed).name == get_format(nameless).name == form.name
    for path in (packed, nameless):
        (one, other) = (form.info(p, DEFAULT) for p in (plain, path))
        assert (one.n_points, dict(one.columns), one.crs) == (other.n_points, dict(other.columns), other.crs)
    for threads, start, stop in [(1, 0, None), (2, 0, None), (1, 120, 310), (1, 499, 500), (1, 7, 7)]:
        options = ReadOptions(n_threads=threads)
        one, other = (form.read(path, options, start=start, stop=stop) for path in (plain, packed))
        np.testing.assert_array_equal(one.world_xyz(), other.world_xyz())
        for name, values in one.columns.items():
            np.testing.assert_array_equal(values, other[name])


@pytest.mark.parametrize("kind", ["ply", "pcd"])
def test_written_as_gzip_and_read_back(tmp_path, rng, kind):
    cloud, path = make_cloud(rng), tmp_path / f"a.b.{kind}.gz"
    form = format_of_name(path)
    form.write(path, cloud, WriteOptions())
    first = path.read_bytes()
    assert first.startswith(b"\x1f\x8b")
    form.write(tmp_path / f"a.{kind}", cloud, WriteOptions())
    assert gzip.decompress(first) == (tmp_path / f"a.{kind}").read_bytes()
    again = get_format(path).read(path, DEFAULT)
    np.testing.assert_allclose(again.world_xyz(), cloud.world_xyz(), rtol=0, atol=1e-9)
    assert again.crs == UTM
    form.write(path, cloud, WriteOptions())
    assert path.read_bytes() == first  # no time in its header
    assert sorted(p.name for p in tmp_path.iterdir() if "part" in p.name) == []


@pytest.mark.parametrize("kind", ["las", "laz", "copc.laz", "e57"])
def test_what_is_not_written_as_gzip_says_so(tmp_path, rng, kind):
    path = tmp_path / f"a.{kind}.gz"
    with pytest.raises(DataError, match=r"a\..*\.gz: (LAS|E57) "):
        format_of_name(path).write(path, make_cloud(rng), WriteOptions(like="none"))
    assert list(tmp_path.iterdir()) == []


def test_points_of_a_packed_las_are_written_with_its_header(tmp_path, rng):
    make_las(tmp_path / "a.las", rng, version="1.2", point_format=3, geotiff=25832)
    (tmp_path / "a.las.gz").write_bytes(gzip.compress((tmp_path / "a.las").read_bytes()))
    form = get_format(tmp_path / "a.las.gz")
    form.write(tmp_path / "b.las", form.read(tmp_path / "a.las.gz", DEFAULT), WriteOptions())
    assert (tmp_path / "b.las").read_bytes() == (tmp_path / "a.las").read_bytes()
    for name in ("a.las", "a.las.gz"):
        write_labelled(tmp_path / name, tmp_path / f"{name}.out.laz", make_labels)
    written = [(tmp_path / f"{name}.out.laz").read_bytes() for name in ("a.las", "a.las.gz")]
    assert written[0] == written[1] and read_header(tmp_path / "a.las.out.laz").n_points == 300


@pytest.mark.parametrize("kind", ["ply", "ascii.ply"])
def test_labels_go_into_a_packed_ply_too(tmp_path, rng, kind):
    plain, packed = tmp_path / f"a.{kind}", tmp_path / f"b.{kind}.gz"
    make_plain(plain, kind, rng)
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    own = [write_labelled(path, tmp_path / "out" / "a.laz", make_labels)[1] for path in (plain, packed)]
    assert own[1].name == packed.name
    assert gzip.decompress(own[1].read_bytes()) == own[0].read_bytes()
    np.testing.assert_array_equal(PlyFormat().read(own[1], DEFAULT)["classification"], make_labels(0, 500)[0])


def pack(data):
    """Pack without the time of day, which would name the tests anew in every process."""
    return gzip.compress(data, mtime=0)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.ply.gz", b"ply\nformat ascii 1.0\n", r"a\.ply\.gz is named as gzip, but holds PLY"),
        ("a.txt.gz", b"1 2 3\n", r"a\.txt\.gz is named as gzip, but holds something that begins with b'1 2 3"),
        ("a.ply", pack(b"ply\n"), r"a\.ply is named as PLY, but holds gzip"),
        ("a.pcd.gz", pack(b"ply\n"), r"a\.pcd\.gz is named as PCD, but holds gzip of PLY"),
        ("a.ply.gz", pack(b"PAR1"), r"a\.ply\.gz is named as PLY, but holds gzip of Parquet"),
        ("points", pack(b"PAR1" * 9), r"points is of no known format: it holds gzip of Parquet"),
        ("points", pack(bytes(99)), r"points is of no known format: it holds gzip of something that begins"),
        ("a.las.gz", pack(b"LASF" * 99)[:12], r"a\.las\.gz is damaged or truncated"),
        ("a.ply.gz", pack(pack(b"ply\n")), r"a\.ply\.gz is named as PLY, but holds gzip of gzip"),
    ],
)
def test_names_that_contradict(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ReadError, match=message):
        get_format(tmp_path / name).info(tmp_path / name, DEFAULT)


def test_a_nameless_packed_table_is_text(tmp_path):
    (tmp_path / "points").write_bytes(gzip.compress(b"x,y,z\n1,2,3\n4,5,6\n"))
    form = get_format(tmp_path / "points")
    assert form.name == "text" and form.read(tmp_path / "points", DEFAULT).xyz.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_streams_have_positions_of_their_own(tmp_path, rng):
    data = rng.bytes(5000)
    (tmp_path / "a.gz").write_bytes(gzip.compress(data))
    file = open_content(tmp_path / "a.gz")
    one, other = file.stream(), file.stream()
    with one, other:
        assert one.read(10) == data[:10] and other.read(4) == data[:4]
        assert one.seek(-5, io.SEEK_END) == 4995 and one.read() == data[-5:]
        assert other.seek(3, io.SEEK_CUR) == 7 and other.read(2) == data[7:9]
    assert file.read(6, 4998) == data[4998:] and file.size == 5000
    np.testing.assert_array_equal(file.records(np.dtype("<u2"), 100, 40), np.frombuffer(data[100:180], "<u2"))
    assert first_bytes(tmp_path / "a.gz", 3) == data[:3]


def test_memory_is_bounded_and_a_full_disk_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "BLOCK", 1 << 16)
    (tmp_path / "a.txt.gz").write_bytes(gzip.compress(bytes(30_000_000)))  # 30 MB in 30 kB
    tracemalloc.start()
    assert Content(tmp_path / "a.txt.gz").size == 30_000_000
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "check_expansion", full)
    with pytest.raises(ReadError, match=r"a\.txt\.gz: .*TMPDIR"):
        Content(tmp_path / "a.txt.gz")
