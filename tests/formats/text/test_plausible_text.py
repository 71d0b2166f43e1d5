"""Text as other programs export it: names in comments, counts, blanks in names, encodings, trailing delimiters."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.formats.text.format import TextFormat
from mlsroad_pipeline.label.writer import write_labelled

TEXT, DEFAULT = TextFormat(), ReadOptions()
ROWS = "9 1 2 3 40\n9 4 5 6 50\n9 7 8 9.5 60\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("savetxt", "# time x y z i\n" + ROWS),
        ("savetxt of two lines", "# made by us\n# GpsTime X Y Z Intensity\n" + ROWS),
        ("commas in the comment", "# time, x, y, z, i\n" + ROWS),
        ("a sentence after the names", "# time x y z i\n# exported on a Monday by somebody here\n" + ROWS),
        ("cloudcompare", "//time X Y Z i\n3\n" + ROWS),
        ("cloudcompare, count first", "3\n//time X Y Z i\n" + ROWS),
        ("count alone in xyz", "# time x y z i\n3\n" + ROWS),
        ("tabs and blanks in names", "GPS Time\tX\tY\tZ\tIntensity\n" + ROWS.replace(" ", "\t")),
        ("numbers in names", "GPS Time 2\tX\tY\tZ\tIntensity\n" + ROWS.replace(" ", "\t")),
        ("names by commas, rows by blanks", "time,x,y,z,intensity\n" + ROWS),
        ("rows end with a comma", "time,x,y,z,i\n" + ROWS.replace(" ", ",").replace("\n", ",\n")),
        ("all end with a semicolon", "time;x;y;z;i;\n" + ROWS.replace(" ", ";").replace("\n", ";\n")),
        ("names end with a comma", "time,x,y,z,i,\n" + ROWS.replace(" ", ",")),
        ("rows end with a tab", "time\tx\ty\tz\ti\n" + ROWS.replace(" ", "\t").replace("\n", "\t\n")),
        ("windows", "# time x y z i\r\n" + ROWS.replace("\n", "\r\n")),
    ],
)
@pytest.mark.parametrize("ending", ["txt", "xyz", "pts", "csv"])
def test_columns_have_their_names(tmp_path, name, text, ending):
    path = tmp_path / f"a.{ending}"
    path.write_text(text, newline="")
    cloud = TEXT.read(path, ReadOptions(intensity_scale=100))
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9.5]], name
    np.testing.assert_allclose(cloud["intensity"], [0.4, 0.5, 0.6], rtol=1e-6)
    assert "column_3" not in cloud


@pytest.mark.parametrize(
    "text", ["# a survey of us\n1 2 3\n4 5 6\n", "# x y\n1 2 3\n4 5 6\n", "1,2,3,\n4,5,6,\n", "1 2 3\n4 5 6\n"]
)
def test_sentences_are_no_names(tmp_path, text):
    path = tmp_path / "a.txt"
    path.write_text(text)
    cloud = TEXT.read(path, DEFAULT)
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]] and not cloud.columns


def test_names_in_a_comment_can_be_refused(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("# z y x\n1 2 3\n4 5 6\n")
    assert TEXT.read(path, DEFAULT).xyz[0].tolist() == [3, 2, 1]
    assert TEXT.read(path, ReadOptions(header=False)).xyz[0].tolist() == [1, 2, 3]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
def test_names_of_any_encoding(tmp_path, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes("x,y,z,höhe,µ\n1,2,3,4,5\n2,3,4,5,6\n".encode(encoding))
    cloud = TEXT.read(path, DEFAULT)
    assert cloud["höhe"].tolist() == [4, 5] and cloud["µ"].tolist() == [5, 6]


def test_a_count_that_differs_is_told(tmp_path):
    path = tmp_path / "a.pts"
    path.write_text("5\n1 2 3\n4 5 6\n")
    assert TEXT.info(path, DEFAULT).notes == ("it states 5 points and holds 2: all are read",)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"a b c d\n1 2 3\n", r"a\.txt, line 1: 4 names for 3 values: 'a b c d'; set header: false"),
        (b"x y z 5\n1 2 3 4\n", r"a\.txt, line 1: neither numbers nor names: 'x y z 5'; set header"),
        (b"x y z a a\n1 2 3 4 5\n", r"line 1: a name is duplicated: x, y, z, a, a; rename one"),
        ("x y z\n1 2 3\n".encode("utf-16"), r"a\.txt .*UTF-16"),
        (b"1 2 3\r4 5 6\r", r"a\.txt: its lines end with carriage returns alone"),
        (b"1 2 3\n4 5 6\n2\n7 8 9\n1 1 1\n", r"a\.txt, line 3: 1 values instead of 3"),
    ],
)
def test_what_is_not_understood_is_shown(tmp_path, data, message):
    path = tmp_path / "a.txt"
    path.write_bytes(data)
    with pytest.raises(ReadError, match=message):
        get_format(path).read(path, DEFAULT)


@pytest.mark.parametrize(
    "text",
    [
        "# time x y z i\n" + ROWS,
        "//time X Y Z i\n3\n" + ROWS,
        "GPS Time\tX\tY\tZ\tIntensity\n" + ROWS.replace(" ", "\t"),
        "time,x,y,z,i\n" + ROWS.replace(" ", ",").replace("\n", ",\n"),
        "time;x;y;z;i;\n" + ROWS.replace(" ", ";").replace("\n", ";\n"),
    ],
)
def test_labelled_copy_reads_like_its_source(tmp_path, text):
    path, out = tmp_path / "a.txt", tmp_path / "out"
    path.write_text(text)
    options = ReadOptions(intensity_scale=100)

    def labels(start, stop):
        n = stop - start
        return np.full(n, 6, np.uint8), np.full(n, 0.5, np.float32), np.zeros(n, np.uint32)

    write_labelled(path, out / "a.laz", labels, options=options)
    old, new = TEXT.read(path, options), TEXT.read(out / "a.txt", options)
    np.testing.assert_array_equal(new.xyz, old.xyz)
    assert set(new.columns) == {*old.columns, "classification", "confidence", "object_id"}
    assert new["classification"].tolist() == [6, 6, 6]


def test_a_last_column_that_is_empty_at_first_keeps_its_name(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,intensity\n" + "0.5,0.25,0.1,\n" * 30 + "1,2,3,0.5\n")
    intensity = TEXT.read(path, ReadOptions(intensity_scale=1))["intensity"]
    assert np.isnan(intensity[:30]).all() and intensity[30] == 0.5
