"""Division of a drive into parts."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.scenes.parts import (
    NEITHER,
    TEST,
    TRAIN,
    HalfPlane,
    Pose,
    parts_beyond,
    within_distance,
)


def test_distance_from_a_plane_is_that_along_its_normal():
    plane = HalfPlane(azimuth=90.0, offset=2.0)
    assert plane.distance(np.array([[5.0, 3.0], [5.0, 0.0]])) == pytest.approx([1.0, -2.0])


def test_the_strip_about_the_plane_belongs_to_neither_part():
    assert parts_beyond([-3.1, -2.9, 0.0, 2.9, 3.1], 6.0).tolist() == [TRAIN, NEITHER, NEITHER, NEITHER, TEST]
    with pytest.raises(ParameterError, match="gap"):
        parts_beyond([1.0], 0.0)


def test_a_scan_is_turned_and_moved_into_the_frame_of_its_drive():
    assert Pose(10.0, 5.0, 90.0).placed(np.array([[2.0, 1.0]])) == pytest.approx(np.array([[9.0, 7.0]]))


def test_near_is_that_of_all_distances():
    rng = np.random.default_rng(0)
    points, others = rng.uniform(0, 9, (300, 3)), rng.uniform(4, 20, (200, 3))
    expected = (np.linalg.norm(points[:, None] - others, axis=2) <= 1.5).any(axis=1)
    assert (within_distance(points, others, 1.5) == expected).all()
    assert 20 < expected.sum() < 280
