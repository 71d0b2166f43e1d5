"""Cloud-optimised files read back by laspy: every point once, spatial queries against brute force."""

import laspy
import numpy as np
import pytest
from helpers.formats import make_las

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.geometry.octree_sample import sample_octree
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.las import copc
from mlsroad_pipeline.formats.las.copc import write_copc
from mlsroad_pipeline.formats.las.format import LasFormat

LAS = LasFormat()


def sorted_records(points):
    raw = np.ascontiguousarray(points.array).view(np.uint8).reshape(len(points), -1)
    return raw[np.lexsort(raw.T)]


def make_street(path, rng, n=60_000):
    """Write points with details at every scale: a plane, a wall, a knot."""
    xyz = np.concatenate([rng.random((n // 2, 3)) * [80, 30, 0.05], rng.random((n // 4, 3)) * [80, 0.1, 9]])
    xyz = np.concatenate([xyz, rng.normal(size=(n // 4, 3)) * 0.3 + [20, 10, 1]])
    columns = {"gps_time": rng.random(n) * 50 + 7, "rgb": rng.integers(0, 256, (n, 3), dtype=np.uint8)}
    columns |= {"classification": rng.integers(0, 70, n, dtype=np.uint8), "confidence": rng.random(n).astype("f4")}
    cloud = PointCloud(xyz, columns, np.array([480_000.0, 5_455_000.0, 100.0]), None)
    LAS.write(path, cloud, WriteOptions(like="none"))


@pytest.mark.parametrize("threads", [1, 2])
def test_laspy_finds_every_point_and_every_box(tmp_path, rng, monkeypatch, threads):
    monkeypatch.setattr(copc, "GATHERED", 9000)
    monkeypatch.setattr(copc, "CHUNK", 25_000)
    monkeypatch.setattr(copc, "sample_octree", lambda xyz: sample_octree(xyz, largest=2000))
    make_street(tmp_path / "a.laz", rng)
    target = tmp_path / "a.copc.laz"
    write_copc(tmp_path / "a.laz", target, n_threads=threads)
    source = laspy.read(tmp_path / "a.laz")
    with laspy.CopcReader.open(target) as reader:
        whole = reader.query()
        np.testing.assert_array_equal(sorted_records(whole), sorted_records(source.points))
        assert (reader.copc_info.gps_min, reader.copc_info.gps_max) == (source.gps_time.min(), source.gps_time.max())
        levels = [len(reader.query(level=depth)) for depth in range(4)]
        assert levels[0] > 1000 and sum(map(bool, levels)) > 2
        low, high = np.array([480_015.0, 5_455_005.0, 100.5]), np.array([480_030.0, 5_455_015.0, 102.0])
        found = reader.query(bounds=laspy.copc.Bounds(low, high))
    world = np.stack([source.x, source.y, source.z], axis=1)
    inside = ((world >= low) & (world <= high)).all(axis=1)
    np.testing.assert_array_equal(sorted_records(found), sorted_records(source.points[inside]))
    info, old = LAS.info(target, ReadOptions()), LAS.info(tmp_path / "a.laz", ReadOptions())
    assert info.n_points == 60_000 and info.details["cloud_optimised"] and not old.details["cloud_optimised"]
    np.testing.assert_array_equal(info.bounds, old.bounds)
    part = LAS.read(target, ReadOptions(n_threads=threads), start=30_000, stop=30_100)
    np.testing.assert_array_equal(part["confidence"], laspy.read(target)["confidence"][30_000:30_100])
    first = target.read_bytes()
    write_copc(tmp_path / "a.laz", target, n_threads=3 - threads)
    assert target.read_bytes() == first


def test_records_of_all_kinds_are_kept(tmp_path, rng):
    make_las(tmp_path / "a.las", rng, version="1.2", point_format=3, geotiff=25832)
    write_copc(tmp_path / "a.las", tmp_path / "b.copc.laz")
    old, new = laspy.read(tmp_path / "a.las"), laspy.read(tmp_path / "b.copc.laz")
    order = np.lexsort([old.X, old.Y, old.Z]), np.lexsort([new.X, new.Y, new.Z])
    for name in ("intensity", "classification", "gps_time", "red", "ring", "height", "return_number", "withheld"):
        np.testing.assert_array_equal(old[name][order[0]], new[name][order[1]])
    assert {vlr.user_id for vlr in new.header.vlrs} >= {"copc", "maker", "LASF_Projection"}
    assert new.header.vlrs[0].user_id == "copc"
    plain = LAS.read(tmp_path / "b.copc.laz", ReadOptions())
    LAS.write(tmp_path / "c.laz", plain, WriteOptions())  # no longer in the order of the octree
    assert "copc" not in {vlr.user_id for vlr in laspy.read(tmp_path / "c.laz").header.vlrs}


def test_empty_and_unfit(tmp_path, rng):
    make_las(tmp_path / "none.las", rng, n=0)
    write_copc(tmp_path / "none.las", tmp_path / "none.copc.laz")
    assert LAS.info(tmp_path / "none.copc.laz", ReadOptions()).n_points == 0
    LAS.write(tmp_path / "one.copc.laz", PointCloud(np.ones((1, 3))), WriteOptions())
    with laspy.CopcReader.open(tmp_path / "one.copc.laz") as reader:
        assert len(reader.query()) == 1
    make_las(tmp_path / "wave.las", rng, point_format=9)
    with pytest.raises(DataError, match=r"wave\.las .*format 9 .*COPC"):
        write_copc(tmp_path / "wave.las", tmp_path / "wave.copc.laz")
    with pytest.raises(DataError, match=r"is named \.copc\.laz"):
        write_copc(tmp_path / "none.las", tmp_path / "b.laz")
    with pytest.raises(DataError, match="would be overwritten"):
        write_copc(tmp_path / "one.copc.laz", tmp_path / "one.copc.laz")


def test_every_point_has_one_node_that_holds_it(rng):
    xyz = np.concatenate([rng.random((20_000, 3)) * [50, 50, 1], rng.random((5000, 3)) * 0.01, np.zeros((300, 3))])
    nodes = sample_octree(xyz, largest=100)
    np.testing.assert_array_equal(np.sort(nodes.order), np.arange(len(xyz)))
    node = np.repeat(np.arange(len(nodes.counts)), nodes.counts)
    side = nodes.size / 2.0 ** nodes.keys[node, 0]
    corner = nodes.low + nodes.keys[node, 1:] * side[:, None]
    slack = nodes.size * 1e-6
    assert (xyz[nodes.order] >= corner - slack).all() and (xyz[nodes.order] <= corner + side[:, None] + slack).all()
    keys = {tuple(key) for key in nodes.keys.tolist()}
    assert len(keys) == len(nodes.keys)
    for depth, *place in keys:
        assert depth == 0 or (depth - 1, *(p // 2 for p in place)) in keys
    assert nodes.keys[:, 0].max() > 3
    with pytest.raises(ParameterError, match="largest"):
        sample_octree(xyz, largest=0)
