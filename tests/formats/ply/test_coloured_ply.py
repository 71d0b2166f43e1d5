"""Labelled files as PLY in the colours of their classes, read back by Open3D."""

import numpy as np
import open3d as o3d
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import las_palette
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.ply import coloured_ply
from mlsroad_pipeline.formats.ply.coloured_ply import coloured_path, write_coloured_ply
from mlsroad_pipeline.formats.ply.format import PlyFormat


def test_open3d_sees_the_colours(tmp_path, rng, monkeypatch):
    monkeypatch.setattr(coloured_ply, "CHUNK", 300)
    codes = rng.choice([2, 5, 11, 64, 66, 200], 1000).astype(np.uint8)
    columns = {"classification": codes, "confidence": rng.random(1000).astype(np.float32)}
    columns["object_id"] = rng.integers(0, 2**32, 1000, dtype=np.uint32)
    cloud = PointCloud(rng.random((1000, 3)) * 90, columns, np.array([480_000.0, 5_455_000.0, 0.0]))
    LasFormat().write(tmp_path / "a.laz", cloud, WriteOptions(like="none"))
    target = coloured_path(str(tmp_path / "a.laz"))
    assert target == str(tmp_path / "a_classes.ply")
    write_coloured_ply(tmp_path / "a.laz", target)
    seen = o3d.t.io.read_point_cloud(target)
    np.testing.assert_allclose(seen.point.positions.numpy(), cloud.xyz, rtol=0, atol=6e-4)
    np.testing.assert_array_equal(seen.point.colors.numpy(), las_palette()[codes])
    again = PlyFormat().read(tmp_path / "a_classes.ply", ReadOptions())
    np.testing.assert_array_equal(again["classification"], codes)
    np.testing.assert_array_equal(again["confidence"], columns["confidence"])
    np.testing.assert_array_equal(again["object_id"], columns["object_id"])
    assert b"comment origin 480000.000 5455000.000 0.000" in (tmp_path / "a_classes.ply").read_bytes()
    with pytest.raises(DataError, match="would be overwritten"):
        write_coloured_ply(tmp_path / "a.laz", tmp_path / "a.laz")


def test_codes_of_results_have_colours_of_their_own():
    palette = las_palette()
    used = [2, 3, 4, 5, 6, 11, 14, 17, 64, 65, 66, 67, 68, 69, 70]
    assert len(np.unique(palette[used], axis=0)) == len(used)
    assert palette.shape == (256, 3)
