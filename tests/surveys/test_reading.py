"""Corridor of a drive: trajectory file, estimated trajectory, or main axis of the points."""

import numpy as np
import pytest
from references.inventory import scanned_street

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.scenes.corridor import MainAxis, corridor_from_arrays, corridor_to_arrays
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.surveys.reading import constant_columns, describe_file, find_corridor, read_and_cut

UTM = np.array([583_000.0, 4_477_000.0, 120.0])
WEEK = 312_345.0


def written(path, xyz, **columns):
    LasFormat().write(path, PointCloud(xyz, columns, UTM), WriteOptions(like="none"))
    return describe_file(str(path), options=ReadOptions(), labels=False, windows=True)


def corridor_of(*described):
    arrays = find_corridor(
        [d["sample"] for d in described], [d["windows"] for d in described], trajectory=None, along=True
    )
    return corridor_from_arrays(arrays), str(arrays.get("note", ""))


def test_path_is_estimated_from_line_scanners_over_several_files(rng, tmp_path):
    xyz, time, centre = scanned_street(rng, seconds=6.0, pulses=60_000, rate=150.0)
    half = len(xyz) // 2
    parts = [
        written(tmp_path / f"{name}.laz", xyz[rows], gps_time=time[rows] + WEEK)
        for name, rows in (("a", slice(0, half)), ("b", slice(half, None)))
    ]
    corridor, note = corridor_of(*parts)
    assert isinstance(corridor, Trajectory)
    true = np.column_stack([np.interp(corridor.time - WEEK, time, centre[:, axis]) for axis in range(3)]) + UTM
    assert np.linalg.norm(corridor.xyz - true, axis=1).max() < 0.05
    way = np.linalg.norm(np.diff(centre[:, :2], axis=0), axis=1).sum()
    assert 0.6 * way < corridor.length < way
    assert "estimated" in note and "a.laz" in note


def test_windows_are_few_points_of_a_long_file(rng, tmp_path):
    xyz, time, _ = scanned_street(rng, seconds=8.0)
    described = written(tmp_path / "a.laz", xyz, gps_time=time)
    windows = described["windows"]
    assert 0.05 * len(xyz) < len(windows) < 0.2 * len(xyz)
    for number in np.unique(windows["window"]):
        assert 0.02 < np.ptp(windows["gps_time"][windows["window"] == number]) < 0.3


@pytest.mark.parametrize("times", ["per turn", "shuffled"])
def test_without_an_estimate_the_axis_is_used_and_the_reason_noted(rng, tmp_path, times):
    xyz, time, _ = scanned_street(rng, seconds=3.0)
    time = np.floor(time * 75) / 75 if times == "per turn" else rng.permutation(time)
    corridor, note = corridor_of(written(tmp_path / "a.laz", xyz, gps_time=time))
    assert isinstance(corridor, MainAxis)
    assert "a.laz: no trajectory from scanner 0" in note and "main axis" in note


@pytest.mark.parametrize("column", [{}, {"gps_time": 1.0}], ids=["without times", "one time"])
def test_without_times_the_axis_is_used_without_a_note(rng, tmp_path, column):
    xyz, time, _ = scanned_street(rng, seconds=1.0)
    described = written(tmp_path / "a.laz", xyz, **{name: np.full(len(time), v) for name, v in column.items()})
    corridor, note = corridor_of(described)
    assert isinstance(corridor, MainAxis) and note == ""


def test_a_trajectory_file_is_preferred(rng, tmp_path):
    xyz, time, _ = scanned_street(rng, seconds=1.0)
    described = written(tmp_path / "a.laz", xyz, gps_time=time)
    path = tmp_path / "trajectory.csv"
    place = UTM
    path.write_text(f"time,x,y,z\n0,{place[0]},{place[1]},0\n1,{place[0] + 10},{place[1]},0\n")
    found = find_corridor([described["sample"]], [described["windows"]], trajectory=str(path), along=True)
    assert corridor_from_arrays(found).length == 10.0 and "note" not in found
    path.write_text(f"time,x,y,z\n0,{place[0] + 5e4},{place[1]},0\n1,{place[0] + 50_010},{place[1]},0\n")
    found = find_corridor([described["sample"]], [described["windows"]], trajectory=str(path), along=True)
    assert "the trajectory trajectory.csv is 49,9" in str(found["note"])


@pytest.mark.parametrize("value", [0, 77])
def test_a_column_with_one_value_is_not_used(rng, tmp_path, value):
    n = 3000
    xyz, path = rng.random((n, 3)) * 5, tmp_path / "a.laz"
    spread = rng.integers(0, 256, (n, 3)).astype(np.uint8)
    described = written(path, xyz, rgb=spread, intensity=np.full(n, value / 255, np.float32))
    assert described["info"]["constant"].tolist() == ["intensity"]

    def cut(constant):
        return read_and_cut(
            str(path), corridor_to_arrays(None), options=ReadOptions(), labels=False, along=False, part=SplitPart(),
            start=0, stop=n, n_total=n, file=0, bin_length=1.0, time_gap=1.0, constant=constant,
        )  # fmt: skip

    assert {"column.rgb", "column.intensity"} <= set(cut(())["points"])
    without = cut(("intensity",))
    assert "column.intensity" not in without["points"] and "column.rgb" in without["points"]
    assert "intensity" not in without["quality"]["columns"]


def test_one_point_that_differs_is_enough_where_the_sample_sees_it():
    same = PointCloud(np.zeros((4, 3)), {"rgb": np.full((4, 3), 9, np.uint8), "intensity": np.zeros(4, np.float32)})
    assert constant_columns(same) == ["rgb", "intensity"]
    same["rgb"][2, 1] = 8
    assert constant_columns(same) == ["intensity"]
    assert constant_columns(same.select(np.array([0]))) == []
