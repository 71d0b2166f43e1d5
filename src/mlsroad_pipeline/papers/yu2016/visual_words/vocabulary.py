"""Clustering of contextual feature groups into words (Yu et al. 2016, section III-F).

The centre of a cluster is a member (equation 18), which needs the distances of all pairs. A cluster too large for such
a matrix is first divided: a sample is clustered into a few parts, every member is assigned to the nearest centre, and
each part receives its share of the words.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column, check_positive
from mlsroad_pipeline.papers.yu2016.visual_words._cells import Context, context_factor, feature_distance, orders
from mlsroad_pipeline.papers.yu2016.visual_words.distance import CONTEXT_FLOOR, WordIndex, inverse_covariance
from mlsroad_pipeline.papers.yu2016.visual_words.groups import ContextualGroups

_ITERATIONS = 20  # most iterations of assignment and update


def _first_centres(matrix: NDArray[np.float64], k: int, draws: NDArray[np.float64]) -> NDArray[np.int64]:
    """Draw up to k distant members as in k-means++; fewer where all others are at distance 0 of one of them."""
    n = len(matrix)
    centres = [min(int(draws[0] * n), n - 1)]
    nearest = np.full(n, np.inf)
    while len(centres) < k:
        nearest = np.minimum(nearest, matrix[:, centres[-1]])
        nearest[centres[-1]] = 0.0
        away, seen = np.flatnonzero(nearest > 0.0), np.cumsum(nearest)
        if len(away) == 0:
            break
        reached = away[seen[away] >= draws[len(centres)] * seen[-1]]
        centres.append(int(reached[0] if len(reached) else away[-1]))
    return np.array(centres)


def central_members(matrix: NDArray[np.float64], k: int, draws: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return up to k centres; the centre of a cluster is the member of least sum of distances, equation 18."""
    centres = _first_centres(matrix, k, draws)
    for _ in range(_ITERATIONS):
        owner = matrix[:, centres].argmin(axis=1)
        before = centres.copy()
        for c in np.unique(owner):
            members = np.flatnonzero(owner == c)
            centres[c] = members[matrix[np.ix_(members, members)].sum(axis=0).argmin()]
        if np.array_equal(before, centres):
            break
    return np.unique(centres)


@dataclass(frozen=True)
class VocabularyParameters:
    """Parameters of the vocabulary."""

    # Number of words. None gives one per `groups_per_word` groups, at most 120,000, the paper's number for 40 samples
    # of 50 m. More words separate objects more finely, until words no longer recur.
    n_words: int | None = None
    groups_per_word: float = 50.0  # Mean number of groups per word, where `n_words` is None
    # Largest cluster with a full distance matrix. Larger follows equation 18 more closely; memory and time grow with
    # the square.
    matrix: int = 500
    branches: int = 16  # Number of parts that a larger cluster is divided into at once
    stop_scenes: float = 0.95  # Words that occur in at least this share of the scenes are candidates for the stop list
    # Largest share of all words on the stop list, the most frequent candidates first. 0 stops none.
    stop_share: float = 0.005
    floor: float = CONTEXT_FLOOR  # Least value of the context factor, see `CONTEXT_FLOOR`
    seed: int = 2016  # Seed of the samples and the initial centres

    def __post_init__(self) -> None:
        if self.n_words is not None:
            check_positive(self.n_words, "n_words")
        check_positive(self.groups_per_word, "groups_per_word")
        if not 2 <= self.branches <= self.matrix:
            raise ParameterError(
                f"branches must be at least 2 and at most matrix, got {self.branches!r} and {self.matrix!r}"
            )
        for name in ("stop_scenes", "stop_share", "floor"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{name} must be between 0 and 1, got {getattr(self, name)!r}")


MAX_WORDS = 120_000
"""Largest vocabulary where `n_words` is None, that of the paper."""


@dataclass(frozen=True)
class Vocabulary:
    """Words and the distance to them."""

    words: ContextualGroups  # The words
    inverse: NDArray[np.float64]  # Inverse covariance over all training features (equation 16)
    stopped: NDArray[np.bool_]  # Words of the stop list, which bags exclude
    floor: float  # Least context factor

    def __len__(self) -> int:
        """Return the number of words."""
        return len(self.words)

    @cached_property
    def index(self) -> WordIndex:
        """Search index of the words."""
        return WordIndex(self.words, self.inverse, self.floor)

    def quantise(self, groups: ContextualGroups, *, n_threads: int = 1) -> NDArray[np.int32]:
        """Return the nearest word of each group."""
        return self.index.search(groups, n_threads=n_threads)[0]


def build_vocabulary(
    groups: ContextualGroups,
    scenes: ArrayLike,
    *,
    parameters: VocabularyParameters = VocabularyParameters(),
    n_threads: int = 1,
) -> tuple[Vocabulary, NDArray[np.int32]]:
    """Cluster training groups into words."""
    if len(groups) == 0:
        raise DataError("no groups to make words of: the training scenes have no objects")
    of_scene = check_column(scenes, len(groups), "scenes")
    inverse = inverse_covariance(groups.descriptors[:, 0])
    n_words = parameters.n_words
    if n_words is None:
        n_words = min(max(round(len(groups) / parameters.groups_per_word), 1), MAX_WORDS)
    chosen = _divide(groups, min(int(n_words), len(groups)), inverse, parameters, n_threads)
    words = groups.select(np.sort(chosen))
    vocabulary = Vocabulary(words, inverse, np.zeros(len(words), np.bool_), parameters.floor)
    nearest = vocabulary.quantise(groups, n_threads=n_threads)
    stopped = stop_list(nearest, of_scene, len(words), parameters)
    return Vocabulary(words, inverse, stopped, parameters.floor), nearest


def stop_list(
    words: NDArray[np.integer], scenes: NDArray, n_words: int, parameters: VocabularyParameters
) -> NDArray[np.bool_]:
    """Return the stop list: the most frequent words that occur in almost all scenes."""
    names, of_scene = np.unique(scenes, return_inverse=True)
    pairs = np.unique(words.astype(np.int64) * len(names) + of_scene)
    spread = np.bincount(pairs // len(names), minlength=n_words) / len(names)
    frequency = np.bincount(words, minlength=n_words)
    common = np.flatnonzero(spread >= parameters.stop_scenes)
    ranked = common[np.argsort(-frequency[common], kind="stable")]
    stopped = np.zeros(n_words, np.bool_)
    stopped[ranked[: int(parameters.stop_share * n_words)]] = True
    return stopped


def _divide(
    groups: ContextualGroups,
    n_words: int,
    inverse: NDArray[np.float64],
    parameters: VocabularyParameters,
    n_threads: int,
) -> NDArray[np.int64]:
    """Return the groups that become words, by divisive clustering."""
    known = WordIndex(groups.select(np.zeros(1, np.int64)), inverse, parameters.floor).context(groups)
    matching = orders(groups.scales.shape[1])
    rng = np.random.default_rng(parameters.seed)
    chosen: list[NDArray[np.int64]] = []
    waiting = [(np.arange(len(groups)), n_words)]
    while waiting:
        members, share = waiting.pop()
        if len(members) <= max(share, 1):
            chosen.append(members)
            continue
        small = len(members) <= parameters.matrix
        sample = members if small else rng.choice(members, parameters.matrix, replace=False)
        matrix = _distances(known, sample, matching, parameters.floor)
        n_parts = share if small else min(parameters.branches, share)
        centres = sample[central_members(matrix, n_parts, rng.random(n_parts))]
        if small or len(centres) == 1:  # all groups of the sample are equal
            chosen.append(centres)
            continue
        index = WordIndex(groups.select(centres), inverse, parameters.floor)
        part, away = index.search(groups.select(members), n_threads=n_threads)
        sizes = np.bincount(part, minlength=len(centres))
        shares = _shares(np.bincount(part, away, minlength=len(centres)).astype(np.float64), sizes, share)
        waiting += [(members[part == k], int(shares[k])) for k in range(len(centres)) if sizes[k]]
    return np.concatenate(chosen)


def _shares(spread: NDArray[np.float64], sizes: NDArray[np.int64], total: int) -> NDArray[np.int64]:
    """Distribute words over parts by the sum of distances to their centres: at least one, at most one per member."""
    shares = np.minimum(np.ones(len(sizes), np.int64), sizes)
    left = total - int(shares.sum())
    while left > 0 and (shares < sizes).any():
        weight = np.where(shares < sizes, spread + 1e-12, 0.0)
        exact = weight / weight.sum() * left
        added = np.minimum(np.floor(exact).astype(np.int64), sizes - shares)
        if added.sum() == 0:
            rest = np.argsort(-np.where(shares < sizes, exact, -1.0), kind="stable")[:left]
            added[rest] = (shares < sizes)[rest]
        shares += added
        left -= int(added.sum())
    return shares


@njit(cache=True, nogil=True)
def _distances(
    known: Context, members: NDArray[np.int64], matching: NDArray[np.int64], floor: float
) -> NDArray[np.float64]:
    """Return the matrix of discriminant group distances from members (rows) to centres (columns)."""
    n = len(members)
    matrix = np.zeros((n, n))
    for i in range(n):
        a = members[i]
        for j in range(n):
            b = members[j]
            factor = context_factor(known.angle[a], known.ratio[a, 0], known.angle[b], known.ratio[b], floor)
            total = feature_distance(
                known.features[a], known.ratio[a, 0], known.features[b], known.ratio[b], matching, np.inf
            )
            matrix[i, j] = factor * total
    return matrix
