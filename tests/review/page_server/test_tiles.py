"""Tiles of points: each point in one node, exact places, brush and cluster against a search over all points."""

import multiprocessing
import threading
from itertools import pairwise

import laspy
import numpy as np
import pytest
from helpers.page_output import FILES, ORIGIN, write_laz, write_output
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.review.page_server import served_survey
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.selection import brushed, cluster
from mlsroad_pipeline.review.page_server.tile_building import (
    LARGEST,
    NoSpaceError,
    build_tiles,
    cube_edge,
    nodes_of_cube,
    unfinished,
)
from mlsroad_pipeline.review.page_server.tile_cache import TileCache
from mlsroad_pipeline.review.page_server.tile_format import LEVELS, TileIndex, first_picture, spacing


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Points, classes, files and tiles of a small output."""
    folder = tmp_path_factory.mktemp("tiles")
    xyz, codes = write_output(folder)
    clouds = CloudFiles.at(folder, list(FILES))
    shares = []
    build_tiles(clouds, folder / "tiles", progress=shares.append)
    assert shares[-1] == pytest.approx(1.0) and all(a <= b for a, b in pairwise(shares))
    return xyz, codes, clouds, TileIndex.read(folder / "tiles")


def all_points(tiles):
    parts = [tiles.load(row) for row in range(len(tiles.nodes))]
    rows = np.concatenate([chunk.rows for _, chunk in parts])
    order = np.argsort(rows)
    return (
        rows[order],
        np.concatenate([xyz for xyz, _ in parts])[order],
        np.concatenate([c.codes for _, c in parts])[order],
    )


def test_each_point_is_in_one_node_at_its_place_with_its_class(built):
    xyz, codes, clouds, tiles = built
    rows, places, found = all_points(tiles)
    np.testing.assert_array_equal(rows, np.arange(len(xyz)))
    assert np.abs(places + clouds.origin - xyz).max() < 0.002
    np.testing.assert_array_equal(found[:, 0], codes)
    assert set(np.unique(found[:, 1])) == {204}  # 0.8 of 255
    np.testing.assert_array_equal(found[:, 2], np.where(xyz[:, 0] > ORIGIN[0] + 30, 5, codes))


def test_levels_hold_one_point_per_cell_and_nodes_are_bounded(rng):
    steps = rng.integers(0, 65536, (300_000, 3)).astype(np.uint16)
    steps[:100_000] = steps[:100_000] // 16
    nodes = list(nodes_of_cube(steps))
    np.testing.assert_array_equal(np.sort(np.concatenate([node.rows for node in nodes])), np.arange(len(steps)))
    assert [node.level for node in nodes] == sorted(node.level for node in nodes)
    for node in nodes:
        if node.level < 2:
            cells = steps[node.rows] >> (16 - 4 - node.level)
            assert len(np.unique(cells, axis=0)) == len(cells)
        if len(node.rows) > LARGEST:
            assert node.level < LEVELS - 1
    assert spacing(32.0, 0) == 2.0


def test_points_at_one_place_end_in_the_last_level():
    steps = np.full((50_000, 3), 777, dtype=np.uint16)
    nodes = list(nodes_of_cube(steps))
    assert sum(len(node.rows) for node in nodes) == 50_000
    assert nodes[-1].level == LEVELS - 1


def test_a_dense_survey_has_smaller_cubes(rng):
    thin, dense = rng.uniform(0, 100, (1000, 3)), rng.uniform(0, 1, (1000, 3))
    assert cube_edge(thin, 1000) == 32.0
    assert cube_edge(dense, 100_000_000) == 2.0


def test_the_brush_takes_all_points_of_its_spheres(built):
    xyz, codes, clouds, tiles = built
    local = xyz - clouds.origin
    centres = np.array([[12.0, 8.0, 1.0], [12.3, 8.0, 1.0]])
    expected = np.unique(np.concatenate(cKDTree(local).query_ball_point(centres, 0.5)).astype(int))
    found = brushed(tiles, centres, 0.5).rows
    assert len(set(found.tolist()) ^ set(expected.tolist())) <= 3  # the tiles round places to half a millimetre
    assert len(found) > 50
    pole = np.array([5.0, 8.0, 4.0])
    own = brushed(tiles, pole[None], 1.0, only=64).rows
    assert set(codes[own]) == {64}


def test_a_stroke_over_too_many_points_is_refused(built, monkeypatch):
    monkeypatch.setattr("mlsroad_pipeline.review.page_server.selection.MOST_POINTS", 100)
    with pytest.raises(ParameterError, match=r"\d+ points are selected, 100 at most"):
        brushed(built[3], np.array([[12.0, 8.0, 1.0]]), 2.0)


def test_a_cluster_is_what_is_connected(built):
    xyz, codes, clouds, tiles = built
    pole = np.flatnonzero((codes == 64) & (np.abs(xyz[:, 0] - ORIGIN[0]) < 1) & (xyz[:, 2] < ORIGIN[2] + 6))
    found = cluster(tiles, np.array([0.0, 0.0, 3.0]) + ORIGIN - clouds.origin, only=64).rows
    missing = set(pole.tolist()) - set(found.tolist())
    assert set(found.tolist()) <= set(pole.tolist())
    assert len(missing) < 0.02 * len(pole)  # single points beside it


def test_tiles_of_a_changed_file_are_built_again(tmp_path, rng):
    path = tmp_path / "one.laz"
    write_laz(path, rng.uniform(0, 5, (100, 3)), np.full(100, 11), np.zeros(100))
    first = TileCache(tmp_path, ["one.laz"])
    clouds = CloudFiles.at(tmp_path, ["one.laz"])
    build_tiles(clouds, first.folder)
    first.keep_picture(first_picture(clouds))
    assert TileCache(tmp_path, ["one.laz"]).kept_picture() == first_picture(clouds)
    assert first.status()["state"] == "ready"
    write_laz(path, rng.uniform(0, 5, (200, 3)), np.full(200, 11), np.zeros(200))
    assert first.status()["state"] == "stale"
    second = TileCache(tmp_path, ["one.laz"])
    assert second.folder != first.folder and second.index() is None and second.kept_picture() is None
    second.start()
    try:
        assert not first.folder.exists() and first.kept_picture() is None
    finally:
        second.stop()


@pytest.mark.parametrize("damage", ["empty index", "short level", "no level", "other format"])
def test_damaged_tiles_are_built_again(tmp_path, rng, damage):
    write_laz(tmp_path / "one.laz", rng.uniform(0, 5, (100, 3)), np.full(100, 11), np.zeros(100))
    clouds = CloudFiles.at(tmp_path, ["one.laz"])
    cache = TileCache(tmp_path, ["one.laz"])
    build_tiles(clouds, cache.folder)
    index, level = cache.folder / "index.json", cache.folder / "level0.bin"
    if damage == "empty index":
        index.write_bytes(b"")
    elif damage == "other format":
        index.write_text(index.read_text().replace('"format":2', '"format":1'))
    elif damage == "no level":
        level.unlink()
    else:
        level.write_bytes(level.read_bytes()[:-1])
    assert cache.index() is None
    build_tiles(clouds, cache.folder)
    assert cache.index() is not None
    cache.keep_picture(first_picture(clouds))
    (picture,) = cache.folder.parent.glob("first-*")
    picture.write_bytes(picture.read_bytes()[:-1])
    assert cache.kept_picture() is None
    cache.keep_picture(first_picture(clouds))
    assert cache.kept_picture() == first_picture(clouds)


def test_the_end_of_the_page_leaves_no_unfinished_tiles(tmp_path, rng):
    write_laz(tmp_path / "one.laz", rng.uniform(0, 5, (100, 3)), np.full(100, 11), np.zeros(100))
    cache = TileCache(tmp_path, ["one.laz"])
    cache.folder.parent.mkdir()
    cache.start()
    unfinished(cache.folder).mkdir()
    cache.stop()
    assert not unfinished(cache.folder).exists()
    before = set(multiprocessing.active_children())  # of other tests
    cache.start()  # by the thread that prepares, after the end
    assert cache.folder.exists() or not set(multiprocessing.active_children()) - before


@pytest.mark.parametrize("most", [255, 65280])
def test_colours_of_8_and_16_bits_are_shown_alike(tmp_path, rng, most):
    path = tmp_path / "one.laz"
    write_laz(path, rng.uniform(0, 5, (100, 3)), np.full(100, 11), np.zeros(100))
    las = laspy.read(path)
    las.red[:] = most
    las.green[:] = las.blue[:] = 0
    las.write(path)
    (block,) = CloudFiles.at(tmp_path, ["one.laz"]).blocks(1000)
    assert set(map(tuple, block.values["rgb"].tolist())) == {(255, 0, 0, 0)}


def test_a_full_disk_is_told_before_anything_is_written(tmp_path, rng, monkeypatch):
    write_laz(tmp_path / "one.laz", rng.uniform(0, 5, (100, 3)), np.full(100, 11), np.zeros(100))
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": 1000})())
    with pytest.raises(NoSpaceError, match="GB are free"):
        build_tiles(CloudFiles.at(tmp_path, ["one.laz"]), tmp_path / "tiles")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.laz"]


def test_tiles_are_built_once_the_browser_has_drawn_the_first_picture(tmp_path, monkeypatch):
    write_output(tmp_path)
    started = threading.Event()
    monkeypatch.setattr(TileCache, "start", lambda tiles: started.set())
    monkeypatch.setattr(served_survey, "_FIRST_WAIT", 60.0)
    survey = served_survey.ServedSurvey(OutputFolder.find(tmp_path), user="ann")
    survey.prepare()
    assert survey.first.chunk and survey.survey() and not started.wait(0.3)
    survey.corrections()
    assert started.wait(30)
    survey.close()
