"""Given ground against a slow reference and planted contradictions."""

import numpy as np

from mlsroad_pipeline.algorithms.ground.given_ground import AROUND, REACH, beyond_ground, lifted_ground


def slow_lifted(xyz, ground):
    cells = np.floor(xyz[:, :2]).astype(int)
    lowest = {}
    for place, z in zip(map(tuple, cells[ground]), xyz[ground, 2], strict=True):
        lowest[place] = min(z, lowest.get(place, np.inf))
    found = np.zeros(len(xyz), bool)
    for i in np.flatnonzero(ground):
        near = [z for place, z in lowest.items() if np.hypot(*(np.array(place) - cells[i])) <= AROUND]
        found[i] = xyz[i, 2] - np.median(near) > 2.0
    return found


def test_lifted_ground_is_that_of_a_slow_reference(rng):
    xyz = rng.random((500, 3)) * [24, 14, 1] + [3, -7, 5]
    xyz[:, 2] += 0.1 * xyz[:, 0]
    xyz[::20, 2] += rng.random(len(xyz[::20])) * 6
    ground = rng.random(500) < 0.8
    found = lifted_ground(xyz, ground)
    assert np.array_equal(found, slow_lifted(xyz, ground)) and 5 < found.sum() < 40


def test_slopes_and_no_ground_contradict_nothing(rng):
    xyz = rng.random((4000, 3)) * [60, 20, 0.05]
    xyz[:, 2] += 0.3 * xyz[:, 0]
    assert not lifted_ground(xyz, np.ones(4000, bool)).any()
    assert not lifted_ground(xyz, np.zeros(4000, bool)).any()


def test_points_far_from_all_ground_are_beyond_it(rng):
    xyz = rng.random((3000, 3)) * [50, 4, 3]
    ground = xyz[:, 0] < 20
    far = beyond_ground(xyz, ground)
    assert far[xyz[:, 0] > 20 + REACH + 2].all() and not far[xyz[:, 0] < 20 + REACH - 2].any()
    assert beyond_ground(xyz, np.zeros(3000, bool)).all()
