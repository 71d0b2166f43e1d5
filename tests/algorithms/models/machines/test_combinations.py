import numpy as np
import pytest

from mlsroad_pipeline.algorithms.models.machines.combinations import rank_pairs


@pytest.mark.parametrize("n_first", [1, 7, 900])
def test_pairs_are_ranked_as_numpy_does(rng, n_first):
    first, second = rng.integers(-1, n_first, (2, 2000)).astype(np.int32)
    first_of, second_of, ranks = rank_pairs(first, second, n_first)
    known = (first >= 0) & (second >= 0)
    pairs, places = np.unique(np.stack([first, second], axis=1)[known], axis=0, return_inverse=True)
    np.testing.assert_array_equal(np.stack([first_of, second_of], axis=1), pairs)
    np.testing.assert_array_equal(ranks[known], places)
    assert (ranks[~known] == -1).all() and ranks.dtype == np.int32


def test_no_pairs_have_no_ranks():
    nothing = np.full(3, -1, np.int32)
    first_of, second_of, ranks = rank_pairs(nothing, np.zeros(3, np.int32), 4)
    assert len(first_of) == len(second_of) == 0 and ranks.tolist() == [-1, -1, -1]
