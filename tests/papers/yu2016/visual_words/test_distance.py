"""Nearest words against an exhaustive search with the written-out distance."""

import numpy as np
import pytest
from references.words import distance

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.yu2016.visual_words.distance import CONTEXT_FLOOR, WordIndex, inverse_covariance
from mlsroad_pipeline.papers.yu2016.visual_words.groups import ContextualGroups


def random_groups(rng, n, m=3, *, kinds=6):
    """Groups around a few kinds of regions; shape and histogram sum to 1 as real ones do."""
    centre = rng.random((kinds, 20))
    rows = np.abs(centre[rng.integers(0, kinds, (n, m))] + rng.normal(0, 0.15, (n, m, 20)))
    rows[..., :3] /= rows[..., :3].sum(axis=-1, keepdims=True)
    rows[..., 3:19] /= rows[..., 3:19].sum(axis=-1, keepdims=True)
    axes = rng.normal(size=(n, m, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    scales = rng.choice([0.1, 0.12, 0.15, 0.2, 0.31], (n, m))
    return ContextualGroups(rows.astype(np.float32), axes.astype(np.float32), scales.astype(np.float32))


def nearest_words(groups, words, *, inverse=None, floor=CONTEXT_FLOOR, n_threads=1):
    """Return the nearest words, by default under the covariance of their own features."""
    if inverse is None:
        inverse = inverse_covariance(words.descriptors) if len(words) else np.eye(1)
    return WordIndex(words, inverse, floor).search(groups, n_threads=n_threads)


def member(groups, i):
    return groups.descriptors[i], groups.orientations[i], groups.scales[i]


@pytest.mark.parametrize(("m", "floor"), [(1, 0.05), (2, 0.05), (3, 0.05), (3, 0.0), (3, 0.4), (4, 0.05)])
def test_nearest_word_equals_brute_force(rng, m, floor):
    groups, words = random_groups(rng, 8, m), random_groups(rng, 130, m)
    inverse = inverse_covariance(words.descriptors)
    found, distances = nearest_words(groups, words, floor=floor)
    for i in range(len(groups)):
        every = [distance(member(groups, i), member(words, j), inverse, floor) for j in range(len(words))]
        assert distances[i] == pytest.approx(min(every)[0], rel=1e-9)
        assert every[found[i]][0] == pytest.approx(min(every)[0], rel=1e-9)


def test_many_cells_give_the_nearest_of_the_words_of_each_part(rng):
    groups, words = random_groups(rng, 100), random_groups(rng, 2000)
    inverse = inverse_covariance(words.descriptors)
    found, distances = nearest_words(groups, words, inverse=inverse)
    # A part fills a single cell, of which every word is tried.
    parts = [nearest_words(groups, words.select(np.arange(a, a + 50)), inverse=inverse) for a in range(0, 2000, 50)]
    table = np.array([part[1] for part in parts])
    np.testing.assert_allclose(distances, table.min(axis=0), rtol=1e-12)
    best = table.argmin(axis=0)
    np.testing.assert_array_equal(found, best * 50 + np.array([parts[p][0][i] for i, p in enumerate(best)]))


def test_a_word_is_nearest_to_itself(rng):
    words = random_groups(rng, 400)
    found, distances = nearest_words(words, words)
    np.testing.assert_array_equal(found, np.arange(400))
    np.testing.assert_array_equal(distances, 0.0)


def test_equal_words_go_to_the_first(rng):
    words = random_groups(rng, 50)
    twice = words.select(np.tile(np.arange(50), 3))
    found, _ = nearest_words(words, twice)
    np.testing.assert_array_equal(found, np.arange(50))


def test_distance_is_invariant_to_sign_of_orientations_and_common_scale(rng):
    groups, words = random_groups(rng, 60), random_groups(rng, 200)
    inverse = inverse_covariance(words.descriptors)
    flipped = ContextualGroups(
        groups.descriptors, groups.orientations * rng.choice([-1, 1], (60, 3, 1)), groups.scales * 3
    )
    one, other = (nearest_words(g, words, inverse=inverse) for g in (groups, flipped))
    np.testing.assert_array_equal(one[0], other[0])
    np.testing.assert_allclose(one[1], other[1], rtol=1e-5)


def test_no_groups_have_no_words(rng):
    words = random_groups(rng, 20)
    found, distances = nearest_words(words.select(np.zeros(0, int)), words)
    assert found.shape == distances.shape == (0,)


def test_result_does_not_depend_on_threads(rng):
    groups, words = random_groups(rng, 200), random_groups(rng, 300)
    one, two = (nearest_words(groups, words, n_threads=n) for n in (1, 2))
    assert one[0].tobytes() == two[0].tobytes() and one[1].tobytes() == two[1].tobytes()


def test_inverse_covariance_is_the_pseudo_inverse(rng):
    rows = random_groups(rng, 500).descriptors
    inverse = inverse_covariance(rows)
    covariance = np.cov(rows.reshape(-1, 20).T.astype(np.float64), bias=True)
    assert np.linalg.matrix_rank(covariance, tol=1e-8) == 18
    np.testing.assert_allclose(covariance @ inverse @ covariance, covariance, atol=1e-8)
    constant = np.full((10, 20), 0.3)
    assert np.abs(inverse_covariance(constant)).max() == 0.0


def test_without_variance_every_word_is_as_near(rng):
    words = random_groups(rng, 5)
    same = ContextualGroups(np.ones_like(words.descriptors), words.orientations, words.scales)
    found, distances = nearest_words(same, same)
    assert np.all(distances == 0.0) and found.tolist() == [0] * 5


def test_bad_input(rng):
    words = random_groups(rng, 4)
    with pytest.raises(DataError, match="the vocabulary has no words"):
        nearest_words(words, words.select(np.zeros(0, int)))
    with pytest.raises(DataError, match=r"groups of shape \(2, 20\) cannot be compared with words of shape \(3, 20\)"):
        nearest_words(random_groups(rng, 4, 2), words)
    with pytest.raises(ParameterError, match=r"floor .*got -1"):
        nearest_words(words, words, floor=-1)
    with pytest.raises(ParameterError, match=r"n_threads .*got 0"):
        WordIndex(words, np.eye(20)).search(words, n_threads=0)
    with pytest.raises(DataError, match=r"a covariance .*got none"):
        inverse_covariance(np.zeros((0, 20)))
    with pytest.raises(DataError, match="a covariance needs finite features, 1 are not"):
        inverse_covariance(np.array([[0.0, np.nan], [1.0, 2.0]]))
    with pytest.raises(DataError, match=r"groups need descriptors \(g, m, d\)"):
        ContextualGroups(np.zeros((2, 3, 20)), np.zeros((2, 3, 3)), np.zeros((2, 2)))
