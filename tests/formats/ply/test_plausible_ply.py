"""PLY headers with lines that are skipped, repeated or not understood, and line ends of any system."""

import numpy as np
import pytest
from helpers.formats import make_labels

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.ply.format import PlyFormat
from mlsroad_pipeline.label.writer import write_labelled

PLY, DEFAULT = PlyFormat(), ReadOptions()
HEAD = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
XYZ = [f"property double {axis}" for axis in "xyz"]
POINTS = np.arange(6.0).reshape(2, 3) + 0.5


def write(path, lines, data=None, end="\n"):
    path.write_bytes(
        (end.join([*lines, "end_header"]) + end).encode("latin-1") + (POINTS.tobytes() if data is None else data)
    )
    return path


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            [*HEAD, *XYZ[:2], "property double", XYZ[2]],
            r"line 6: not understood: 'property double'; correct the header",
        ),
        ([*HEAD, *XYZ, "property double nx ny"], r"line 7: not understood: 'property double nx ny'"),
        ([*HEAD, *XYZ, "property list uchar int"], r"line 7: not understood"),
        ([*HEAD, *XYZ, "property list uchar real indices"], r"line 7: not understood"),
        ([*HEAD, *XYZ, "propery double w"], r"line 7: not understood: 'propery double w'"),
        ([*HEAD, *XYZ, "property half w"], r"line 7: not understood"),
        (
            [*HEAD, *XYZ, "property double x"],
            r"line 7: property 'x' is repeated: 'property double x'; rename or remove it",
        ),
        ([*HEAD, *XYZ, "element vertex 2"], r"line 7: element 'vertex' is repeated"),
        ([*HEAD, HEAD[1], *XYZ], r"line 4: a second format"),
        ([HEAD[0], *XYZ, *HEAD[1:]], r"line 2: not understood"),
        ([*HEAD[:2], "element vertex 2 3", *XYZ], r"line 3: not understood"),
        ([*HEAD, *XYZ, "scale 0.001"], r"line 7: not understood: 'scale 0\.001'"),
        ([*HEAD, *XYZ, "ply"], r"line 7: not understood: 'ply'"),
    ],
)
def test_lines_that_change_the_records_are_errors(tmp_path, lines, message):
    path = write(tmp_path / "a.ply", lines)
    with pytest.raises(ReadError, match=r"a\.ply, " + message):
        PLY.read(path, DEFAULT)


@pytest.mark.parametrize(
    "more",
    [
        ["comment property double w"],
        ["obj_info made by hand"],
        [""],
        ["   "],
        ["comment"],
        ["comment end_header is next"],
        ["comment \x0cform feed \x85"],
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_without_meaning_are_read_over(tmp_path, more, end):
    path = write(tmp_path / "a.ply", [*HEAD, *more, *XYZ, *more], end=end)
    np.testing.assert_array_equal(PLY.read(path, DEFAULT).xyz, POINTS)
    write_labelled(path, tmp_path / "out" / "a.laz", make_labels)
    np.testing.assert_array_equal(PLY.read(tmp_path / "out" / "a.ply", DEFAULT).xyz, POINTS)


def test_points_that_begin_with_a_line_feed(tmp_path):
    first = np.frombuffer(b"\n" + POINTS.tobytes()[1:], "<f8").reshape(2, 3)
    for end in ("\n", "\r", "\r\n"):
        path = write(tmp_path / "a.ply", [*HEAD, *XYZ], first.tobytes(), end=end)
        np.testing.assert_array_equal(PLY.read(path, DEFAULT).xyz, first)


def test_properties_that_differ_in_case_are_kept(tmp_path):
    lines = [*HEAD, *XYZ, "property double X"]
    path = write(tmp_path / "a.ply", lines, np.arange(8.0).tobytes())
    cloud = PLY.read(path, DEFAULT)
    assert cloud.xyz.tolist() == [[0, 1, 2], [4, 5, 6]] and cloud["file_X"].tolist() == [3, 7]
