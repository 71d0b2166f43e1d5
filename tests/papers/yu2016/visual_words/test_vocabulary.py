"""Words of planted kinds of groups, and the clustering against its equations."""

import numpy as np
import pytest
from references.words import distance

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.papers.yu2016.visual_words._cells import orders
from mlsroad_pipeline.papers.yu2016.visual_words.distance import WordIndex, inverse_covariance
from mlsroad_pipeline.papers.yu2016.visual_words.groups import ContextualGroups
from mlsroad_pipeline.papers.yu2016.visual_words.vocabulary import (
    Vocabulary,
    VocabularyParameters,
    _distances,
    build_vocabulary,
    central_members,
    stop_list,
)


def planted(rng, n, kinds=5, spread=0.005):
    """Groups of a few kinds that lie close together; the kind of each."""
    kind = rng.integers(0, kinds, n)
    centre = np.random.default_rng(1).random((kinds, 3, 20))
    axes = np.random.default_rng(2).normal(size=(kinds, 3, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    rows = centre[kind] + rng.normal(0, spread, (n, 3, 20))
    scales = np.random.default_rng(3).uniform(0.1, 0.3, (kinds, 3))[kind]
    groups = ContextualGroups(rows.astype(np.float32), axes[kind].astype(np.float32), scales.astype(np.float32))
    return groups, kind


def test_matrix_and_centres_follow_their_equations(rng):
    groups, _ = planted(rng, 24)
    inverse = inverse_covariance(groups.descriptors)
    known = WordIndex(groups, inverse).context(groups)
    matrix = _distances(known, np.arange(24), orders(3), 0.05)

    def member(i):
        return groups.descriptors[i], groups.orientations[i], groups.scales[i]

    by_hand = [[distance(member(i), member(j), inverse, 0.05)[0] for j in range(24)] for i in range(24)]
    np.testing.assert_allclose(matrix, by_hand, rtol=1e-8, atol=1e-9)
    centres = central_members(matrix, 5, rng.random(5))
    owner = centres[matrix[:, centres].argmin(axis=1)]
    for centre in centres:  # equation 18: no other member is nearer to all
        members = np.flatnonzero(owner == centre)
        sums = matrix[np.ix_(members, members)].sum(axis=0)
        assert sums[members == centre] == pytest.approx(sums.min())


@pytest.mark.parametrize("matrix", [60, 1000], ids=["divided", "at once"])
def test_every_planted_kind_has_its_word(rng, matrix):
    groups, kind = planted(rng, 900)
    parameters = VocabularyParameters(n_words=5, matrix=matrix, branches=8, stop_share=0)
    vocabulary, found = build_vocabulary(groups, np.zeros(900, int), parameters=parameters)
    assert len(vocabulary) == 5
    np.testing.assert_array_equal(found, vocabulary.quantise(groups))
    for k in range(5):
        assert len(np.unique(found[kind == k])) == 1
    assert len({found[kind == k][0] for k in range(5)}) == 5


def test_number_of_words_and_same_seed_same_words(rng):
    groups, _ = planted(rng, 1200, kinds=40, spread=0.05)
    parameters = VocabularyParameters(groups_per_word=10.0, matrix=100, branches=4)
    one, two = (build_vocabulary(groups, np.zeros(1200, int), parameters=parameters, n_threads=n)[0] for n in (1, 2))
    assert len(one) == pytest.approx(120, abs=3)
    assert one.words.descriptors.tobytes() == two.words.descriptors.tobytes()
    every, _ = build_vocabulary(
        groups.select(np.arange(7)), np.zeros(7, int), parameters=VocabularyParameters(n_words=50)
    )
    assert len(every) == 7  # no more words than groups


@pytest.mark.parametrize("matrix", [30, 500], ids=["divided", "at once"])
def test_equal_groups_make_one_word(rng, matrix):
    groups, _ = planted(rng, 80, kinds=1, spread=0.0)
    parameters = VocabularyParameters(n_words=5, stop_share=0, matrix=matrix)
    assert len(build_vocabulary(groups, np.zeros(80, int), parameters=parameters)[0]) == 1


def test_stop_list_takes_the_most_frequent_words_of_almost_all_scenes():
    words = np.array([0] * 10 + [1] * 8 + [2] * 6 + [3] * 2)
    scenes = np.concatenate([np.tile([0, 1], 5), np.tile([0, 1], 4), np.zeros(6, int), [0, 1]])
    parameters = VocabularyParameters(stop_scenes=0.9, stop_share=0.5)
    assert stop_list(words, scenes, 4, parameters).tolist() == [True, True, False, False]
    assert not stop_list(words, scenes, 4, VocabularyParameters(stop_share=0)).any()


def test_bad_input(rng):
    groups, _ = planted(rng, 4)
    with pytest.raises(DataError, match="no groups to make words of"):
        build_vocabulary(groups.select(np.zeros(0, int)), [])
    with pytest.raises(DataError, match="scenes"):
        build_vocabulary(groups, [0])
    with pytest.raises(ParameterError, match=r"branches .*got 1 and 500"):
        VocabularyParameters(branches=1)
    with pytest.raises(ParameterError, match=r"stop_share .*got 2"):
        VocabularyParameters(stop_share=2)
    with pytest.raises(DataError, match="cannot be compared"):
        Vocabulary(groups, np.eye(20), np.zeros(4, bool), 0.05).quantise(
            ContextualGroups(np.zeros((1, 2, 20)), np.zeros((1, 2, 3)), np.ones((1, 2)))
        )
