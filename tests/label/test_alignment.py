"""Files and passes that lie apart: their moves in the plan of a survey, and scenes with moved points."""

from types import SimpleNamespace

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.objects.sightings import ROUTE, SECOND
from mlsroad_pipeline.algorithms.registration.network import Move, adjust
from mlsroad_pipeline.algorithms.registration.offset import Offset
from mlsroad_pipeline.label.alignment import PassMove, aligned, moves_of_passes
from mlsroad_pipeline.surveys.pass_offsets import Recording, SurveyOffsets

ORIGIN = np.array([480_000.0, 5_455_000.0, 100.0])
STILL = Move((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0))


def scene():
    xyz = np.array([[1, 1, 0], [2, 1, 0], [3, 1, 0], [4, 1, 0]], dtype=np.float32)
    columns = {"file": np.array([0, 0, 1, 1], np.int16), SECOND: np.array([5, 700, 5, 700], np.int32)}
    return PointCloud(xyz, columns, ORIGIN)


def test_points_of_one_pass_of_one_file_are_moved():
    move = Move((0.5, -0.25, -40.0), 0.0, tuple(ORIGIN.tolist()))
    moved = aligned(scene(), [PassMove(1, 600.0, np.inf, None, move)])
    expected = scene().world_xyz() + np.array([[0, 0, 0]] * 3 + [[0.5, -0.25, -40.0]])
    np.testing.assert_allclose(moved.world_xyz(), expected, atol=1e-5)
    assert moved.xyz.dtype == np.float32 and (moved.xyz >= 0).all()


def test_points_are_turned_about_the_middle_of_their_pass():
    move = Move((0.0, 0.0, 0.0), np.pi / 2, tuple((ORIGIN + [1, 1, 0]).tolist()))
    moved = aligned(scene(), [PassMove(0, -np.inf, np.inf, None, move)])
    np.testing.assert_allclose(moved.world_xyz()[:2] - ORIGIN, [[1, 1, 0], [1, 2, 0]], atol=1e-5)


def test_points_without_times_are_moved_by_route():
    cloud = scene().without_columns([SECOND]).with_columns(**{ROUTE: np.array([7, 8, 7, 8], np.int32)})
    move = Move((1.0, 0.0, 0.0), 0.0, tuple(ORIGIN.tolist()))
    moved = aligned(cloud, [PassMove(0, -np.inf, np.inf, 8, move)])
    np.testing.assert_allclose(moved.world_xyz()[:, 0] - ORIGIN[0], [1, 3, 3, 4], atol=1e-5)


def test_a_scene_without_moves_is_the_same_object():
    cloud = scene()
    assert aligned(cloud, []) is cloud
    assert aligned(cloud, [PassMove(9, -np.inf, np.inf, None, Move((1.0, 0, 0), 0.0, (0.0, 0.0, 0.0)))]) is cloud


def offsets(shift):
    recordings = (Recording(0, 0, (), False, "a.laz"), Recording(1, 1, (600,), False, "b.laz (pass 2)"))
    return SurveyOffsets(recordings, (), (STILL, Move(shift, 0.0, (0.0, 0.0, 0.0))))


PLAN = SimpleNamespace(files=[SimpleNamespace(pass_key="p", number=0), SimpleNamespace(pass_key="p", number=1)])


def test_moves_that_count_are_those_of_the_plan():
    assert moves_of_passes(PLAN, offsets((0.01, 0.02, 0.03)), SimpleNamespace(slug="pool")) == {}
    found = moves_of_passes(PLAN, offsets((0.3, 0.0, 0.0)), SimpleNamespace(slug="pool"))
    ((move,),) = found.values()
    assert (move.file, move.first, move.stop) == (1, 600, np.inf)


def test_methods_with_images_are_not_aligned():
    with pytest.raises(
        ParameterError, match=r"label.align_passes: b.laz \(pass 2\) would be moved away from its images"
    ):
        moves_of_passes(PLAN, offsets((0.3, 0.0, 0.0)), SimpleNamespace(slug="image_labels"))


def measured(shift):
    return Offset(np.array(shift, dtype=float), np.full(3, 0.004), 500, 0.0, 1e-4, np.zeros(3))


def test_the_pass_that_stands_alone_is_moved():
    pairs = {(0, 1): measured([0.5, 0, 0.2]), (1, 2): measured([0, 0, 0]), (0, 2): measured([0.5, 0, 0.2])}
    moves = adjust(np.zeros((3, 3)), pairs, np.arange(3))
    np.testing.assert_allclose([move.shift for move in moves], [[-0.5, 0, -0.2], [0, 0, 0], [0, 0, 0]], atol=1e-3)


def test_files_of_one_pass_move_together_where_one_of_them_is_measured():
    nothing = Offset(np.full(3, np.nan), np.full(3, np.nan), 0, 0.0, np.nan, np.zeros(3))
    pairs = {(0, 1): measured([0.5, 0, 0.2]), (1, 2): nothing}
    moves = adjust(np.zeros((3, 3)), pairs, np.array([0, 1, 1]))
    np.testing.assert_allclose(moves[2].shift, moves[1].shift, atol=0.01)
