"""Groups of points to look at first: uncertain ones come first, objects and answered groups are left out."""

import numpy as np
import pytest
from helpers.page_output import ORIGIN, write_laz

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.review.page_server import point_groups
from mlsroad_pipeline.review.page_server.cloud_files import CloudFiles
from mlsroad_pipeline.review.page_server.point_groups import PointGroups
from mlsroad_pipeline.review.page_server.tile_building import build_tiles
from mlsroad_pipeline.review.page_server.tile_format import TileIndex
from mlsroad_pipeline.review.painted import NONE, Painted

ROAD, WALL, HEDGE, CAR = 11, 6, 3, 67
PLACES = {WALL: (10.0, 6.0), HEDGE: (30.0, 6.0), CAR: (20.0, -5.0)}


@pytest.fixture(scope="module")
def tiles(tmp_path_factory):
    """A sure road, an uncertain wall, a less uncertain hedge, and an uncertain car that is an object."""
    rng, folder = np.random.default_rng(3), tmp_path_factory.mktemp("groups")
    boxes = [rng.uniform([x - 1.5, y - 0.4, 0.2], [x + 1.5, y + 0.4, 2.2], (3000, 3)) for x, y in PLACES.values()]
    road = np.column_stack([rng.uniform(0, 40, 40_000), rng.uniform(-8, 8, 40_000), rng.normal(0, 0.01, 40_000)])
    codes = np.repeat([ROAD, *PLACES], [40_000, 3000, 3000, 3000])
    sure = {ROAD: 0.99, WALL: 0.3, HEDGE: 0.6, CAR: 0.3}
    confidence = np.vectorize(sure.get)(codes)
    write_laz(folder / "a.laz", np.concatenate([road, *boxes]), codes, 9 * (codes == CAR), confidence=confidence)
    build_tiles(CloudFiles.at(folder, ["a.laz"]), folder / "tiles")
    return TileIndex.read(folder / "tiles"), CloudFiles.at(folder, ["a.laz"]).origin, codes


def test_the_least_certain_group_comes_first_and_objects_are_left_out(tiles):
    index, origin, codes = tiles
    found = PointGroups(index)
    groups = found.first(20)
    assert [group["code"] for group in groups[:2]] == [WALL, HEDGE]
    assert groups[0]["confidence"] == pytest.approx(0.3, abs=0.01)
    assert {group["code"] for group in groups} == {ROAD, WALL, HEDGE}
    place = np.array(groups[0]["place"]) + origin - ORIGIN
    assert np.abs(place[:2] - PLACES[WALL]).max() < 1.6
    rows = found.points(np.array(groups[0]["place"]), WALL).rows
    assert len(rows) > 2500 and (codes[rows] == WALL).all()


def test_answered_groups_are_not_asked_again(tiles):
    index, _, _ = tiles
    found = PointGroups(index)
    rows = found.points(np.array(found.first(1)[0]["place"]), WALL).rows
    painted = Painted.of([(rows.astype(np.int64), WALL)])
    assert WALL not in {group["code"] for group in found.first(20, painted)}
    assert WALL in {group["code"] for group in found.first(20, NONE)}
    # Painted points count with their new class.
    again = found.points(np.array(found.first(1)[0]["place"]), WALL, Painted.of([(rows, HEDGE)])).rows
    assert not set(again.tolist()) & set(rows.tolist())


def test_a_group_that_is_left_out_comes_back(tiles):
    found = PointGroups(tiles[0])
    place = np.array(found.first(1)[0]["place"])
    found.leave_out(place)
    assert found.first(1)[0]["code"] == HEDGE
    found.leave_out(place, back=True)
    assert found.first(1)[0]["code"] == WALL
    with pytest.raises(ParameterError, match="no group of points at this place"):
        found.leave_out(place + 100)


def test_a_large_survey_is_sampled_by_cubes(tiles, monkeypatch):
    index = tiles[0]
    whole = PointGroups(index)
    monkeypatch.setattr(point_groups, "SAMPLED", 3000)
    part = PointGroups(index)
    assert 0 < len(part._sample.rows) < len(whole._sample.rows)
    assert part.first(5)


def test_points_of_a_dense_group_are_taken_nearer_by(tiles, monkeypatch):
    found = PointGroups(tiles[0])
    place = np.array(found.first(1)[0]["place"])
    whole = found.points(place, WALL).rows
    monkeypatch.setattr("mlsroad_pipeline.review.page_server.selection.MOST_POINTS", len(whole) - 1)
    assert 0 < len(found.points(place, WALL).rows) < len(whole)


def test_groups_of_a_sparse_scan_are_larger(tmp_path, rng):
    xyz = np.column_stack([rng.permutation(3600) % 60, np.arange(3600) // 60, np.zeros(3600)]) * 0.9
    write_laz(tmp_path / "a.laz", xyz, np.full(3600, WALL), np.zeros(3600, int), confidence=0.5)
    build_tiles(CloudFiles.at(tmp_path, ["a.laz"]), tmp_path / "tiles")
    found = PointGroups(TileIndex.read(tmp_path / "tiles"))
    assert found._scale == pytest.approx(0.9 / 0.4, rel=0.1)
    assert len(found.points(np.array(found.first(1)[0]["place"]), WALL).rows) >= 9


def test_a_survey_of_objects_alone_has_no_groups(tmp_path, rng):
    write_laz(tmp_path / "a.laz", rng.uniform(0, 3, (500, 3)), np.full(500, 67), np.ones(500, int))
    build_tiles(CloudFiles.at(tmp_path, ["a.laz"]), tmp_path / "tiles")
    assert PointGroups(TileIndex.read(tmp_path / "tiles")).first(10) == []
