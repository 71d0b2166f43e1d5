"""Intensities of any scale: how they are mapped to 0 to 1, the messages, and the original values in the results."""

import laspy
import numpy as np
import pytest
from helpers.formats import make_labels, make_las

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.e57.format import E57Format
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.registry import format_of_name
from mlsroad_pipeline.label.writer import write_labelled

AUTO = ReadOptions(intensity_scale="auto")
XYZ = np.arange(15.0).reshape(5, 3)


def table(path, values):
    if path.suffix in (".txt", ".pts"):
        np.savetxt(path, np.column_stack([XYZ, values]), header="x y z intensity", fmt="%.6g")
    elif path.suffix == ".npz":
        np.savez(path, xyz=XYZ, intensity=values)
    else:
        cloud = PointCloud(XYZ, {"reflectance": values}, np.zeros(3), None, str(path))
        format_of_name(path).write(path, cloud, WriteOptions())
    return format_of_name(path)


@pytest.mark.parametrize("ending", ["txt", "pts", "npz", "ply", "parquet", "pcd"])
@pytest.mark.parametrize(
    "values", [[-25.5, -3.0, 0.0, 2.0, 12.5], [-2048, -100, 0, 5, 2047], [-9.0, -8.0, -7.5, -7.0, -1.0], [-1.0] * 5]
)
@pytest.mark.parametrize("options", [ReadOptions(), AUTO, ReadOptions(intensity_scale="max")])
def test_negative_intensities_are_mapped_by_their_range(tmp_path, ending, values, options):
    path = tmp_path / f"a.{ending}"
    form = table(path, np.array(values, dtype=np.float32))
    cloud = form.read(path, options)
    low, high = min(values), max(values) if max(values) > min(values) else min(values) + 1
    np.testing.assert_allclose(cloud["intensity"], (np.array(values) - low) / (high - low), atol=1e-6)
    np.testing.assert_allclose(cloud["original_intensity"], values, rtol=1e-6)
    note = f"intensities from {low:g} to {high:g} are mapped to 0 to 1; intensity_range sets other limits"
    assert note in form.info(path, options).notes
    part = form.read(path, options, start=2, stop=4)
    np.testing.assert_array_equal(part["intensity"], cloud["intensity"][2:4])
    write_labelled(path, tmp_path / "out" / "a.laz", make_labels, options=options)
    np.testing.assert_allclose(laspy.read(tmp_path / "out" / "a.laz")["original_intensity"], values, rtol=1e-6)


def test_a_range_can_be_given(tmp_path):
    path = tmp_path / "a.txt"
    form = table(path, np.array([-30.0, -20, -10, 0, 10]))
    given = form.read(path, ReadOptions(intensity_range=(-20, 0)))
    np.testing.assert_allclose(given["intensity"], [0, 0, 0.5, 1, 1])
    for wrong in ([0, 0], [1], [1, 2, 3], ["a", 2], 5, [np.nan, 1]):
        with pytest.raises(ParameterError, match="intensity_range must be"):
            ReadOptions(intensity_range=wrong)


@pytest.mark.parametrize("dtype", ["u2", "i2", "u4", "i4", "i8"])
def test_eight_bits_in_wider_fields(tmp_path, dtype):
    path = tmp_path / "a.npz"
    form = table(path, np.array([0, 1, 20, 100, 255], dtype=dtype))
    np.testing.assert_allclose(form.read(path, AUTO)["intensity"], np.array([0, 1, 20, 100, 255]) / 255, rtol=1e-6)
    assert "is divided by 255; intensity_scale changes that" in form.info(path, AUTO).notes[0]
    full = np.iinfo(dtype).max
    np.testing.assert_allclose(
        form.read(path, ReadOptions())["intensity"], np.array([0, 1, 20, 100, 255]) / full, rtol=1e-6
    )


@pytest.mark.parametrize("extension", ["las", "laz"])
def test_eight_bits_of_las(tmp_path, rng, extension):
    path = tmp_path / f"a.{extension}"
    las = make_las(path, rng, extras=False)
    las.intensity[:] = rng.integers(0, 256, 300)
    las.intensity[0] = 255
    las.write(str(path))
    form, stored = LasFormat(), np.asarray(laspy.read(path).intensity)
    cloud = form.read(path, AUTO)
    np.testing.assert_allclose(cloud["intensity"], stored / 255, rtol=1e-6)
    assert form.info(path, AUTO).notes == (
        "intensity has 8 bits in a field of 16 and is divided by 255; intensity_scale changes that",
    )
    write_labelled(path, tmp_path / "out" / "a.laz", make_labels, options=AUTO)
    np.testing.assert_array_equal(laspy.read(tmp_path / "out" / "a.laz").intensity, stored)


@pytest.mark.parametrize(
    ("values", "limit"), [([0, 0.5, 3, 100, 255], 255), ([0, 0.5, 3, 4000, 60000], 65535), ([0, 0.1, 0.2, 0.5, 1], 1)]
)
def test_limits_of_e57_that_are_too_small(tmp_path, values, limit):
    path = tmp_path / "a.e57"
    form = E57Format()  # writes limits 0 and 1
    cloud = PointCloud(XYZ, {"intensity": np.array(values, np.float32)}, np.zeros(3), None, str(path))
    form.write(path, cloud, WriteOptions())
    read = form.read(path, AUTO)
    np.testing.assert_allclose(read["intensity"], np.array(values) / limit, rtol=1e-6)
    notes = form.info(path, AUTO).notes
    assert bool(notes) == (limit > 1)
    if limit > 1:
        assert notes[0].startswith(f"scan 0 states intensities from 0 to 1 and has 0 to {max(values)}")
        np.testing.assert_allclose(read["original_intensity"], values)


def test_intensities_of_8_bits_that_are_read_by_the_type_are_written_as_they_were(tmp_path):
    path = tmp_path / "a.las"
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.x, las.y, las.z = XYZ.T
    las.intensity = np.arange(100, 105)
    las.write(path)
    for name, options in (("by_type.las", ReadOptions()), ("by_range.las", AUTO)):
        LasFormat().write(tmp_path / name, LasFormat().read(path, options), WriteOptions())
        assert laspy.read(tmp_path / name).intensity.tolist() == [100, 101, 102, 103, 104]
