"""Layout of undescribed text files: marks, names, words, colours."""

import gzip

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import MissingColumnError, ParameterError, ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.registry import get_format
from mlsroad_pipeline.formats.text.format import TextFormat

TEXT = TextFormat()
DEFAULT = ReadOptions()


@pytest.mark.parametrize("delimiter", [";", "\t", " ", "  ", ", "])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("names", [None, ("Easting", "Northing", "Height", "Reflectance"), ("X", "Y", "Z", "other")])
def test_delimiters_and_decimal_marks(tmp_path, rng, caplog, delimiter, decimal, names):
    if delimiter == ", " and decimal == ",":
        delimiter = "|"
    values = np.round(rng.random((30, 4)) * 1000, 3)
    values[0] = [1, 2, 3, 4]  # whole numbers tell nothing of the mark
    values[:, 3] /= 4096
    rows = [delimiter.join(repr(v).replace(".", decimal) for v in row) for row in values.tolist()]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(([delimiter.join(names)] if names else []) + rows) + "\n")
    options = ReadOptions(delimiter="|") if delimiter == "|" else DEFAULT
    with caplog.at_level("INFO"):
        cloud = TEXT.read(path, options)
    np.testing.assert_array_equal(cloud.world_xyz(), values[:, :3])
    fourth = "column_3" if names is None else {"Reflectance": "intensity"}.get(names[3], names[3])
    np.testing.assert_allclose(cloud[fourth], values[:, 3], rtol=1e-6)
    assert "30 rows" in caplog.text
    assert ("decimal comma" in caplog.text) == (decimal == ",")
    assert ("column 'Reflectance' is read as intensity" in caplog.text) == (fourth == "intensity")
    assert TEXT.info(path, options).details["decimal"] == decimal


def test_the_marks_can_be_given(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("1,5 2,5 3,5\n4 5 6\n")
    assert TEXT.read(path, DEFAULT).xyz.tolist() == [[1.5, 2.5, 3.5], [4, 5, 6]]
    with pytest.raises(MissingColumnError, match="no column 'x'"):
        TEXT.read(path, ReadOptions(decimal=".", delimiter=" "))
    path.write_text("1,2,3\n4,5,6\n")
    assert TEXT.read(path, DEFAULT).xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    path.write_text("x;y;z\n1,5;2;3\n4,5;5,5;x\n")
    with pytest.raises(ReadError, match=r"line 3: 'x' is not a number"):
        TEXT.read(path, DEFAULT)
    for wrong in (ReadOptions, lambda **k: ReadOptions(delimiter=",", **k)):
        with pytest.raises(ParameterError, match=r"decimal must be '\.' or ','"):
            wrong(decimal="'" if wrong is ReadOptions else ",")


def test_words_are_left_out_and_named(tmp_path, caplog):
    path = tmp_path / "a.csv"
    path.write_text('id,"x","y",z,when,red\n"P1","1.5",2,3,2020-01-01T00:00:00,7\n"P2","4",5,6,2020-01-02T00:00:00,8\n')
    with caplog.at_level("INFO"):
        cloud = TEXT.read(path, DEFAULT)
    assert "id, when left out, for they hold no numbers" in caplog.text
    assert cloud.xyz.tolist() == [[1.5, 2, 3], [4, 5, 6]]
    assert cloud["red"].tolist() == [7, 8]


@pytest.mark.parametrize("columns", [6, 7])
def test_colours_without_names(tmp_path, rng, caplog, columns):
    xyz, rgb = np.round(rng.random((200, 3)) * 90, 3), rng.integers(0, 256, (200, 3))
    intensity = rng.integers(0, 4096, (200, columns - 6))
    path = tmp_path / "a.pts.gz"
    rows = "\n".join(" ".join(map(str, row)) for row in np.hstack([xyz, intensity, rgb]).tolist())
    rows = rows.replace(".0 ", " ").replace(".0\n", "\n")
    path.write_bytes(gzip.compress(f"200\n{rows}\n".encode()))
    with caplog.at_level("INFO"):
        cloud = get_format(path).read(path, DEFAULT)
    assert "read as rgb" in caplog.text
    np.testing.assert_array_equal(cloud["rgb"], rgb)
    np.testing.assert_array_equal(cloud.xyz, xyz)
    assert ("intensity" in cloud) == (columns == 7)
    given = TEXT.read(path, ReadOptions(columns={"label": columns - 1}))
    np.testing.assert_array_equal(given["label"], rgb[:, 2])
    assert "rgb" not in given
    late = np.hstack([xyz, intensity, rgb])
    late[100, -1] = 256  # in the middle of the file
    np.savetxt(tmp_path / "b.txt", late)
    assert "rgb" not in TEXT.read(tmp_path / "b.txt", DEFAULT)


def test_units_of_times(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,gps_time\n1,2,3,85462112\n4,5,6,85462152\n")
    cloud = TEXT.read(path, ReadOptions(time_scale=1e-3, time_offset=604_800.0))
    np.testing.assert_allclose(cloud["gps_time"], [604_800 + 85_462.112, 604_800 + 85_462.152], rtol=0, atol=1e-6)
    with pytest.raises(ParameterError, match="time_scale must be .* > 0"):
        ReadOptions(time_scale=0)


@pytest.mark.real_data
def test_millimetres_of_a_recording(real_data):
    path = real_data("taiwan_poles", "MTL.csv.gz")
    names = {"intensity": 3, "gps_time": 4}
    cloud = get_format(path).read(path, ReadOptions(columns=names, units="millimetre", time_scale=1e-6))
    low, high = cloud.xyz.min(axis=0), cloud.xyz.max(axis=0)
    assert 2 < high[2] - low[2] < 20 and (high[:2] - low[:2] < 20).all()  # a pole
    assert cloud["intensity"].min() >= 0 and cloud["intensity"].max() <= 1
