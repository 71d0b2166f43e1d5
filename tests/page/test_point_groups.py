"""Groups of points to look at first: uncertain ones come first, objects and answered groups are left out."""

import numpy as np
import pytest
from helpers.page_output import ORIGIN, write_laz

from mlsroad_pipeline.page.cloud_files import CloudFiles
from mlsroad_pipeline.page.point_groups import PointGroups, points_of_group
from mlsroad_pipeline.page.selection import NONE, Painted
from mlsroad_pipeline.page.tile_building import build_tiles
from mlsroad_pipeline.page.tile_format import TileIndex

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
    groups = PointGroups(index).first(20)
    assert [group["code"] for group in groups[:2]] == [WALL, HEDGE]
    assert groups[0]["confidence"] == pytest.approx(0.3, abs=0.01)
    assert {group["code"] for group in groups} == {ROAD, WALL, HEDGE}
    place = np.array(groups[0]["place"]) + origin - ORIGIN
    assert np.abs(place[:2] - PLACES[WALL]).max() < 1.6
    rows = points_of_group(index, np.array(groups[0]["place"]), WALL)
    assert len(rows) > 2500 and (codes[rows] == WALL).all()


def test_answered_groups_are_not_asked_again(tiles):
    index, _, _ = tiles
    found = PointGroups(index)
    rows = points_of_group(index, np.array(found.first(1)[0]["place"]), WALL)
    painted = Painted.of([(rows.astype(np.int64), WALL)])
    assert WALL not in {group["code"] for group in found.first(20, painted)}
    assert WALL in {group["code"] for group in found.first(20, NONE)}
    # Painted points count with their new class.
    again = points_of_group(index, np.array(found.first(1)[0]["place"]), WALL, Painted.of([(rows, HEDGE)]))
    assert not set(again.tolist()) & set(rows.tolist())


def test_a_survey_of_objects_alone_has_no_groups(tmp_path, rng):
    write_laz(tmp_path / "a.laz", rng.uniform(0, 3, (500, 3)), np.full(500, 67), np.ones(500, int))
    build_tiles(CloudFiles.at(tmp_path, ["a.laz"]), tmp_path / "tiles")
    assert PointGroups(TileIndex.read(tmp_path / "tiles")).first(10) == []
