"""Text tables against split and float."""

import gzip

import numpy as np
import pytest
from helpers.formats import read_text_slowly

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError, ReadError, UnknownClassError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.text import values as text_rows
from mlsroad_pipeline.formats.text.format import TextFormat

TEXT = TextFormat()
DEFAULT = ReadOptions()


def rows_of(values, delimiter):
    return [delimiter.join(repr(value) for value in row) for row in values.tolist()]


@pytest.mark.parametrize("delimiter", [" ", "\t", ",", ";", "   "])
@pytest.mark.parametrize("ends", [("\n", True), ("\n", False), ("\r\n", True), ("\r\n", False)])
@pytest.mark.parametrize("head", ["", "# a scan\n#  of a street\n", "\n# late comment\n"])
def test_delimiters_line_ends_and_heads(tmp_path, rng, delimiter, ends, head):
    line_end, last = ends
    values = rng.normal(size=(30, 5)) * 100
    path = tmp_path / "a.txt"
    body = line_end.join(rows_of(values, delimiter)) + (line_end + "  " + line_end if last else "")
    path.write_bytes((head + body).encode())
    cloud = TEXT.read(path, DEFAULT)
    np.testing.assert_array_equal(cloud.world_xyz(), values[:, :3])
    np.testing.assert_array_equal(cloud["column_3"], values[:, 3])
    np.testing.assert_array_equal(cloud["column_4"], values[:, 4])
    assert TEXT.info(path, DEFAULT).n_points == 30


@pytest.mark.parametrize("n_threads", [1, 2])
@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_ranges_across_marks(tmp_path, rng, monkeypatch, name, n_threads):
    monkeypatch.setattr(text_rows, "STRIDE", 7)
    monkeypatch.setattr(text_rows, "BLOCK", 100)
    values = rng.normal(size=(101, 4))
    text = "x,y,z,time\n" + "\n".join(rows_of(values, ",")) + "\n"
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith("gz") else text.encode())
    options = ReadOptions(n_threads=n_threads)
    for start, stop in [(0, 101), (0, 7), (6, 8), (7, 14), (100, 101), (50, None), (33, 33)]:
        part = TEXT.read(path, options, start=start, stop=stop)
        np.testing.assert_array_equal(part.world_xyz(), values[start:stop, :3])
        np.testing.assert_array_equal(part["time"], values[start:stop, 3])


def test_names_roles_and_types(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        '//X;Y;"Z";R;G;B;Intensity;label;instance;GpsTime\n1;2;3;255;0;9;128;7;2;10.5\n4;5;6;1;2;3;255;8;0;11\n'
    )
    cloud = TEXT.read(path, DEFAULT)
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud["rgb"].tolist() == [[255, 0, 9], [1, 2, 3]]
    np.testing.assert_array_equal(cloud["intensity"], np.float32([128 / 255, 1]))
    assert cloud["label"].tolist() == [7, 8]
    assert cloud["gps_time"].tolist() == [10.5, 11.0]
    assert {name: str(values.dtype) for name, values in cloud.columns.items()} == {
        **{"rgb": "uint8", "intensity": "float32", "label": "int32", "instance": "int32", "gps_time": "float64"}
    }
    assert dict(TEXT.info(path, DEFAULT).columns) == {name: values.dtype for name, values in cloud.columns.items()}


def test_mapping_by_index_units_and_coding(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("10,480000000,5455000000,2000,65535\n11,480001000,5455000000,2000,0\n")
    options = ReadOptions(
        columns={"label": 0, "x": 1, "y": 2, "z": 3, "intensity": 4}, units="millimetre", coding={10: "car", 11: "tree"}
    )
    cloud = TEXT.read(path, options)
    assert cloud.world_xyz().tolist() == [[480000, 5455000, 2], [480001, 5455000, 2]]
    assert cloud.origin.tolist() == [480000, 5455000, 0]
    assert (cloud["label"].tolist(), cloud["label"].dtype) == ([50, 31], np.uint8)
    assert cloud["intensity"].tolist() == [1.0, 0.0]
    assert set(cloud.columns) == {"label", "intensity"}
    with pytest.raises(UnknownClassError, match=r"a\.csv.*11 \(1 points\)"):
        TEXT.read(path, ReadOptions(columns=options.columns, coding={10: "car"}))
    with pytest.raises(MissingColumnError, match=r"a\.csv has no column 9"):
        TEXT.read(path, ReadOptions(columns={"label": 9}))


def test_taken_names_are_kept_aside(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,label,other\n1,2,3,4,5\n")
    cloud = TEXT.read(path, ReadOptions(columns={"label": "other"}))
    assert {name: values.tolist() for name, values in cloud.columns.items()} == {"label": [5], "file_label": [4]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# only\n# comments\n", r"a\.txt has no rows of points"),
        ("x y z\n", r"a\.txt has no rows of points"),
        ("x y z\n" + "\n" * 30, r"a\.txt has no rows of points"),
        ("x y z\n" + "\n" * 30 + "1 2 3\n", r"a\.txt, line 2: 0 values instead of 3: ''"),
        ("1 2\n3 4\n", r"a\.txt, line 1: '1 2' has 2 values"),
        ("1 2 3\n4 5 6\n7 8\n9 1 2\n", r"a\.txt, line 3: 2 values instead of 3: '7 8'"),
        ("# c\n1 2 3\n4 5 6 7\n", r"a\.txt, line 3: 4 values instead of 3: '4 5 6 7'"),
        ("1,2,3\n4,five,6\n", r"a\.txt, line 2: 'five' is not a number: '4,five,6'"),
        ("1,2,3\n\n4,5,6\n", r"a\.txt, line 2: (0|1) values instead of 3: ''"),
        ("1 2 3\n# late\n4 5 6\n", r"a\.txt, line 2: 2 values instead of 3: '# late'"),
        ("x y z\n1 2 3\n4 5 6_0\n", r"a\.txt, line 3: '6_0' is not a number"),
        ("1 b 3\n4 5 6\n", r"a\.txt, line 1: neither numbers nor names: '1 b 3'"),
        ("x,y,z\n1,2,3,4\n", r"a\.txt, line 1: 3 names for 4 values"),
        ("x,y,y\n1,2,3\n", r"a\.txt, line 1: a name is duplicated"),
        ("rechts,y,z\n1,2,3\n", r"a\.txt has no column 'x' \(columns: rechts, y, z\)"),
    ],
)
def test_bad_rows(tmp_path, text, message):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DataError, match=message):
        TEXT.read(tmp_path / "a.txt", DEFAULT)


def test_bad_values(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1 2 3\n4 nan 6\n7 8 inf\n")
    with pytest.raises(DataError, match=r"a\.txt: 2 .* row 1: \[4\.0, nan"):
        TEXT.read(path, DEFAULT)
    path.write_text("x y z label\n1 2 3 4\n1 2 3 4.5\n")
    with pytest.raises(DataError, match=r"a\.txt: .*'label' .*4\.5"):
        TEXT.read(path, DEFAULT)
    path.write_text("x,y,z,time\n1,2,3,\n4,5,6,7\n")  # a missing value is NaN
    np.testing.assert_array_equal(TEXT.read(path, DEFAULT)["time"], [np.nan, 7])


def test_truncated_gzip(tmp_path):
    path = tmp_path / "a.txt.gz"
    packed = gzip.compress(b"1 2 3\n" * 1000)
    for size in (3, 12, len(packed) // 2, len(packed) - 1):
        path.write_bytes(packed[:size])
        with pytest.raises(ReadError, match=r"a\.txt\.gz is damaged"):
            TEXT.read(path, DEFAULT)


def test_a_changed_file_is_read_anew(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1 2 3\n")
    assert len(TEXT.read(path, DEFAULT)) == 1
    path.write_text("1 2 3\n4 5 6\n")
    assert len(TEXT.read(path, DEFAULT)) == 2


@pytest.mark.parametrize("name", ["a.txt", "a.csv.gz"])
@pytest.mark.parametrize("n", [0, 1, 60])
def test_written_and_read_back(tmp_path, rng, name, n):
    columns = {
        "rgb": rng.integers(0, 256, (n, 3)).astype(np.uint8),
        "intensity": rng.random(n).astype(np.float32),
        "gps_time": rng.random(n) * 1e5,
        "label": rng.integers(0, 90, n).astype(np.int32),
        "normal": rng.normal(size=(n, 3)).astype(np.float32),
    }
    cloud = PointCloud(rng.random((n, 3)), columns, np.array([482_000.0, 5_455_000.0, 0]))
    options = WriteOptions(delimiter=",", decimals=5)
    TEXT.write(tmp_path / name, cloud, options)
    first = (tmp_path / name).read_bytes()
    TEXT.write(tmp_path / name, cloud, options)
    assert (tmp_path / name).read_bytes() == first
    if n == 0:
        with pytest.raises(ReadError, match="has no rows of points"):
            TEXT.read(tmp_path / name, DEFAULT)
        return
    back = TEXT.read(tmp_path / name, DEFAULT)
    np.testing.assert_allclose(back.world_xyz(), cloud.world_xyz(), rtol=0, atol=5.1e-6)
    for column in ("rgb", "intensity", "gps_time", "label"):
        np.testing.assert_array_equal(back[column], columns[column])
    np.testing.assert_array_equal(back["normal_2"].astype(np.float32), columns["normal"][:, 2])


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("parts", "delimiter", "skip"),
    [
        (("oakland", "oakland_part2_ac.xyz_label_conf.gz"), None, None),
        (("isprs", "samp11.txt"), None, 0),
        (("taiwan_poles", "b.csv.gz"), ",", 0),
    ],
)
def test_recordings(real_data, parts, delimiter, skip):
    path = real_data(*parts)
    if skip is None:
        with gzip.open(path, "rt") as stream:
            skip = next(i for i, line in enumerate(stream) if not line.startswith("#"))
    values = read_text_slowly(path, delimiter, skip)
    cloud = TEXT.read(path, DEFAULT)
    np.testing.assert_allclose(cloud.world_xyz(), values[:, :3], rtol=0, atol=1e-9)
    last = "confidence" if parts[0] == "oakland" else "column_3"
    np.testing.assert_array_equal(cloud[last], values[:, -1])
