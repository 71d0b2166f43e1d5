"""Profiles of objects over height, distance from the axis, shape and intensity."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.papers.yu2016.visual_words.profiles import (
    BANDS,
    KINDS,
    N_BLIND,
    N_PLACES,
    N_SHARES,
    RINGS,
    TONES,
    measure_profiles,
    profile_similarity,
    surface_kinds,
    without_intensities,
)


def lamp(rng, x=0.0, y=0.0, turn=0.0):
    """A mast of 6 m with an arm of 2 m."""
    mast = np.column_stack([np.zeros((600, 2)), np.linspace(0, 6, 600)])
    arm = np.column_stack([np.linspace(0, 2, 200), np.zeros(200), np.full(200, 6.0)])
    points = np.concatenate([mast, arm])
    about = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.column_stack([points[:, :2] @ about.T + [x, y], points[:, 2]])


def test_shares_by_hand():
    """Twelve places above each other and one aside of the highest, all in voxels of their own."""
    column = np.column_stack([np.zeros((12, 2)), 0.05 + np.arange(12) / 2])
    points = np.concatenate([column, [[1.0, 0.0, 5.55]], column + [50.0, 0, 0]])
    owner = np.repeat([0, 2], [13, 12])
    found = measure_profiles(points, owner)[:, :N_PLACES].reshape(3, BANDS, len(RINGS))
    assert found[0, :, 0].tolist() == pytest.approx([1 / 13] * 12)
    assert found[0, -1, np.searchsorted(RINGS, 1.0)] == pytest.approx(1 / 13)
    assert found[0].sum() == pytest.approx(1.0)
    assert not found[1].any()  # no point is of object 1
    assert found[2, :, 0].tolist() == pytest.approx([1 / 12] * 12)


def test_profiles_are_invariant_to_position_rotation_order_and_density(rng):
    one = measure_profiles(lamp(rng), np.zeros(800, int))
    order = rng.permutation(800)
    many = np.repeat(lamp(rng), 5, axis=0)
    for points in (lamp(rng, 30.0, -8.0)[order], lamp(rng, turn=1.0), many):
        other = measure_profiles(points, np.zeros(len(points), int))
        assert profile_similarity(one, other)[0, 0] > 0.8
    block = rng.uniform([-2, -1, 0], [2, 1, 1.5], (4000, 3))
    assert profile_similarity(one, measure_profiles(block, np.zeros(4000, int)))[0, 0] < 0.2


def test_similarity_is_the_sum_of_minima_over_the_sum_of_maxima():
    one, other = np.array([[0.5, 0.5, 0.0], [0.0, 0.0, 0.0]]), np.array([[0.25, 0.25, 0.5], [0.5, 0.5, 0.0]])
    np.testing.assert_allclose(profile_similarity(one, other), [[0.5 / 1.5, 1.0], [0.0, 0.0]])
    assert profile_similarity(one[1:], one[1:])[0, 0] == 0.0  # nothing is like nothing
    with pytest.raises(DataError, match="2 and 3 shares"):
        profile_similarity(one[:, :2], other)


def test_no_objects_have_no_profiles():
    assert measure_profiles(np.zeros((5, 3)), np.full(5, -1)).shape == (0, N_SHARES)


def test_shares_of_intensity_by_hand():
    """A dull post of twelve voxels, the highest two of which are bright on average; one lies outside of [0, 1]."""
    column = np.column_stack([np.zeros((12, 2)), 0.05 + np.arange(12) / 2])
    points = np.concatenate([column, column[-2:] + [0.0, 0.0, 0.01]])
    intensity = np.r_[np.full(10, 0.25), 0.6, 1.0, 0.9, 1.5]
    found = measure_profiles(points, np.zeros(14, int), intensity=intensity)[0, N_BLIND:].reshape(BANDS, TONES)
    assert found.sum() == pytest.approx(1.0)
    assert found[:10, TONES // 4].tolist() == pytest.approx([1 / 12] * 10)
    assert found[10, 3 * TONES // 4] == pytest.approx(1 / 12)  # the mean of 0.6 and 0.9
    assert found[11, -1] == pytest.approx(1 / 12)  # what is brighter than 1 is in the brightest step
    with pytest.raises(DataError, match="intensity"):
        measure_profiles(points, np.zeros(14, int), intensity=intensity[:3])


def test_intensities_separate_objects_of_one_shape_and_can_be_excluded(rng):
    """A panel that reflects and one that does not, on the same post."""
    points, owner = lamp(rng), np.zeros(800, int)
    dull = measure_profiles(points, owner, intensity=np.full(800, 0.3))
    bright = measure_profiles(points, owner, intensity=np.where(points[:, 2] > 5, 0.95, 0.3))
    assert profile_similarity(dull, dull)[0, 0] == 1.0
    assert profile_similarity(dull, bright)[0, 0] < 0.9
    np.testing.assert_array_equal(without_intensities(bright), measure_profiles(points, owner))
    assert bright[:, N_PLACES:].any()


def _sheet(across, along, n=25):
    """Voxels of a plane through two directions, 0.1 m apart."""
    steps = 0.1 * np.arange(n)
    first, second = np.meshgrid(steps, steps, indexing="ij")
    return first.reshape(-1, 1) * np.array(across) + second.reshape(-1, 1) * np.array(along)


@pytest.mark.parametrize(
    ("kind", "points"),
    [
        (0, 0.1 * np.arange(40)[:, None] * [0, 0, 1]),
        (1, 0.1 * np.arange(40)[:, None] * [0.7, 0, 0.7]),
        (2, 0.1 * np.arange(40)[:, None] * [0.6, 0.8, 0]),
        (3, _sheet([0.6, 0.8, 0], [0, 0, 1])),
        (4, _sheet([1, 0, 0], [0, 0.7, 0.7])),
        (5, _sheet([1, 0, 0], [0, 1, 0])),
        (6, np.stack(np.meshgrid(*[0.1 * np.arange(12)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)),
        (7, np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 2.0]])),
    ],
)
def test_lines_planes_and_volumes_are_classified_by_inclination(kind, points):
    shares = measure_profiles(points + 0.05, np.zeros(len(points), int))[0]
    of_kind = shares[N_PLACES:N_BLIND].reshape(BANDS, KINDS).sum(axis=0)
    assert of_kind.sum() == pytest.approx(1.0)
    assert of_kind.argmax() == kind and of_kind[kind] > 0.6


def test_surfaces_are_those_of_the_voxels_around_by_hand_and_end_with_their_object(rng):
    """Against sums over all pairs, on two clouds that lie in each other."""
    points = rng.uniform(0, 1.2, (700, 3)) * [1, 1, 0.4]
    cells = np.floor(points / 0.1).astype(np.int64)[:, ::-1]
    owner = np.repeat([0, 1], 350)
    order = np.lexsort([cells[:, 2], cells[:, 1], cells[:, 0], owner])
    points, cells, owner = points[order], cells[order], owner[order]
    found = surface_kinds(points, cells, np.array([0, 350, 700]))
    for i in range(0, 700, 7):
        around = (np.abs(cells - cells[i]) <= 2).all(axis=1) & (owner == owner[i])
        if around.sum() < 4:
            assert found[i] == 7
            continue
        values, vectors = np.linalg.eigh(np.cov(points[around].T, bias=True))
        short, middle, long = np.sqrt(values)
        up, normal = abs(vectors[2, 2]), abs(vectors[2, 0])
        line, plane = (0 if up > 0.9 else 1 if up > 0.4 else 2), (3 if normal < 0.3 else 4 if normal < 0.8 else 5)
        assert found[i] == [line, plane, 6][int(np.argmax([long - middle, middle - short, short]))]
