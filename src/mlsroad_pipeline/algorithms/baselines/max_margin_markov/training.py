"""Training max-margin Markov networks by functional gradient boosting (Munoz et al. 2009).

In every round the labelling is sought that scores most when wrong labels get a bonus (the loss); where it differs from
the truth, the truth's labels are to score more and those found less, and a small regression tree is fitted to these
wishes and added.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.baselines.max_margin_markov.classifier import SLUG, MaxMarginMarkov
from mlsroad_pipeline.algorithms.baselines.max_margin_markov.graph import MarkovGraph, build_markov_graph
from mlsroad_pipeline.algorithms.baselines.max_margin_markov.network import PARTS, MarkovNetwork, clique_shares
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.algorithms.patches.extraction import Patches
from mlsroad_pipeline.algorithms.patches.training import train_model

_EXPONENTS = {"balanced": 1.0, "sqrt": 0.5, "none": 0.0}

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class MarginParameters:
    """Parameters of the network and its training.

    Parameters
    ----------
    n_rounds : int, default 40
        Trees of each kind. More fit the training scenes better; time grows with them.
    step : float, default 1.0
        Factor of the first tree; that of round t is divided by the square root of t.
    site_depth : int, default 8
        Levels of the trees of sites.
    context_depth : int, default 3
        Levels of the trees of pairs and cliques.
    min_samples_leaf : int, default 10
        Fewest rows of a leaf.
    batch_patches : int, default 20000
        Patches of a round: scenes are drawn until there are as many. More give steadier steps and longer rounds.
    fit_rows : int, default 10000
        Sites, pairs and cliques that a tree is fitted to, drawn by what they weigh. Time grows with it.
    class_weight : {"balanced", "sqrt", "none"}, default "sqrt"
        What the patches of a class weigh together in fitting: the same, the square root of their number, their number.
    clique_shares : sequence of float, default [0.03, 0.01]
        Clusters of each k-means segmentation as a share of the patches (luo2016: 0.03 and 0.01); empty for no cliques.
    truncation : float, default 0.3
        Share of deviating members at which a clique's score is spent, at most 0.5.
    temperature : float, default 1.0
        What scores are divided by on their way to probabilities.
    seed : int, default 2009
        Seed of the order of scenes and of ties in trees.

    Raises
    ------
    ParameterError
        If a number is out of its range or `class_weight` is unknown.
    """

    n_rounds: int = 40
    step: float = 1.0
    site_depth: int = 8
    context_depth: int = 3
    min_samples_leaf: int = 10
    batch_patches: int = 20_000
    fit_rows: int = 10_000
    class_weight: str = "sqrt"
    clique_shares: Sequence[float] = field(default_factory=lambda: [0.03, 0.01])
    truncation: float = 0.3
    temperature: float = 1.0
    seed: int = 2009

    def __post_init__(self) -> None:
        for name in ("n_rounds", "site_depth", "context_depth", "min_samples_leaf", "batch_patches", "fit_rows"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        for name in ("step", "truncation", "temperature"):
            check_positive(getattr(self, name), f"{SLUG}.{name}")
        if self.truncation > 0.5:
            raise ParameterError(f"{SLUG}.truncation must be at most 0.5, got {self.truncation!r}")
        if self.class_weight not in _EXPONENTS:
            raise ParameterError(f"{SLUG}.class_weight must be one of {list(_EXPONENTS)}, got {self.class_weight!r}")
        if any(not 0 < share <= 1 for share in self.clique_shares):
            raise ParameterError(f"{SLUG}.clique_shares must lie in (0, 1], got {list(self.clique_shares)}")


@dataclass(frozen=True, eq=False)
class _Scene:
    graph: MarkovGraph
    truth: NDArray[np.int32]


def _wishes(scene: _Scene, found: NDArray[np.int32], network: MarkovNetwork) -> dict[str, NDArray[np.float64]]:
    """Return what each site, pair and clique should score more (+) and less (-): the functional gradient."""
    graph, truth, eye = scene.graph, scene.truth, np.eye(network.n_labels)
    ends = graph.edges
    wishes = {"sites": eye[truth] - eye[found], "pairs": np.zeros((len(ends), network.n_labels))}
    for labels, sign in ((truth, 1.0), (found, -1.0)):
        agree = labels[ends[:, 0]] == labels[ends[:, 1]]
        wishes["pairs"][agree] += sign * eye[labels[ends[agree, 0]]]
    shape = (graph.indptr, graph.members, network.n_labels, network.truncation)
    wishes["groups"] = clique_shares(truth, *shape) - clique_shares(found, *shape)
    return wishes


def _rounds(scenes: Sequence[_Scene], batch_patches: int, n_rounds: int, seed: int) -> list[list[_Scene]]:
    """Deal the scenes out to the rounds, in a new order each time all have been dealt."""
    rng = np.random.default_rng(seed)
    waiting: list[int] = []
    batches = []
    for _ in range(n_rounds):
        batch: list[_Scene] = []
        while sum(len(scene.truth) for scene in batch) < batch_patches and len(batch) < len(scenes):
            if not waiting:
                waiting = rng.permutation(len(scenes)).tolist()
            batch.append(scenes[waiting.pop()])
        batches.append(batch)
    return batches


def _boost(
    network: MarkovNetwork,
    batch: Sequence[_Scene],
    weights: NDArray[np.float64],
    round_number: int,
    p: MarginParameters,
    pool: ThreadPoolExecutor,
) -> float:
    """Add one tree of each kind; return the share of sites that the search found a wrong label for."""
    wishes: dict[str, list[NDArray]] = {part: [] for part in PARTS}
    rows: dict[str, list[NDArray]] = {part: [] for part in PARTS}
    counts: dict[str, list[NDArray]] = {part: [] for part in PARTS}
    wrong = 0

    def search(scene: _Scene) -> NDArray[np.int32]:
        bonus = 1.0 - np.eye(network.n_labels)[scene.truth]
        return network.best_labels(scene.graph, network.potentials(scene.graph), bonus)

    for scene, found in zip(batch, pool.map(search, batch), strict=True):
        wrong += int((found != scene.truth).sum())
        for part, wish in _wishes(scene, found, network).items():
            wishes[part].append(wish)
            rows[part].append(getattr(scene.graph, part))
        counts["sites"].append(weights[scene.truth])
        counts["pairs"].append(np.minimum(*weights[scene.truth][scene.graph.edges.T]))
        counts["groups"].append(scene.graph.sizes.astype(np.float64))
    rng = np.random.default_rng([p.seed, round_number])
    for number, part in enumerate(PARTS):
        share = np.concatenate(counts[part])
        drawn = rng.choice(len(share), p.fit_rows, p=share / share.sum()) if len(share) else np.zeros(0, np.int64)
        network.trees[part].grow(
            np.concatenate(rows[part])[drawn],
            np.concatenate(wishes[part])[drawn],
            np.ones(len(drawn)),
            step=p.step / np.sqrt(round_number + 1.0),
            max_depth=p.site_depth if part == "sites" else p.context_depth,
            min_samples_leaf=p.min_samples_leaf,
            seed=p.seed + len(PARTS) * round_number + number,
        )
    return wrong / sum(len(scene.truth) for scene in batch)


def fit_max_margin(
    patches: Patches,
    edges: NDArray[np.int32],
    *,
    n_classes: int,
    parameters: MarginParameters | None = None,
    n_threads: int = 1,
) -> MaxMarginMarkov:
    """Learn from labelled patches.

    Parameters
    ----------
    patches : Patches
        Labelled patches of one or more scenes; `scene` says which belong together.
    edges : ndarray of int32, shape (e, 2)
        Pairs of patches that touch; pairs of different scenes are left out.
    n_classes : int
        Classes of the scheme; one without patches is never given.
    parameters : MarginParameters, optional
        The parameters; the defaults where None.
    n_threads : int, default 1
        Threads that label the scenes of a round; the network does not depend on it.

    Returns
    -------
    MaxMarginMarkov
        The trained labeller.

    Raises
    ------
    DataError
        If there is no patch, or one has no label of the scheme, or all are of one class.
    """
    p = parameters if parameters is not None else MarginParameters()
    if len(patches) == 0:
        raise DataError("no patches to train on")
    if patches.label.min() < 0 or patches.label.max() >= n_classes:
        raise DataError(
            f"labels of training patches must be from 0 to {n_classes - 1}, got {patches.label.min()} to "
            f"{patches.label.max()}"
        )
    sizes = np.bincount(patches.label, minlength=n_classes)
    if np.count_nonzero(sizes) < 2:
        raise DataError(f"all training patches are of class {int(sizes.argmax())}: there is nothing to tell apart")
    weights = np.where(sizes > 0, 1.0 / np.maximum(sizes, 1) ** _EXPONENTS[p.class_weight], 0.0)
    weights *= len(patches) / (weights * sizes).sum()
    network = MarkovNetwork(n_classes, p.truncation)
    network.known = sizes > 0
    scenes = _split(patches, np.asarray(edges), p.clique_shares)
    errors = []
    with ThreadPoolExecutor(n_threads) as pool:
        for number, batch in enumerate(_rounds(scenes, p.batch_patches, p.n_rounds, p.seed)):
            errors.append(_boost(network, batch, weights, number, p, pool))
            logger.debug("round %d: %.3f of the sites wrong", number + 1, errors[-1])
    colour = np.zeros(0, np.float32) if patches.rgb is None else patches.rgb.mean(axis=0, dtype=np.float64)
    return MaxMarginMarkov(network, p.clique_shares, p.temperature, colour.astype(np.float32), errors)


def _split(patches: Patches, edges: NDArray[np.int32], clique_shares: Sequence[float]) -> list[_Scene]:
    """Cut the training set into its scenes, each with its graph."""
    scenes = []
    for number in np.unique(patches.scene):
        rows = np.flatnonzero(patches.scene == number)
        place = np.full(len(patches), -1, np.int32)
        place[rows] = np.arange(len(rows), dtype=np.int32)
        inside = place[edges.reshape(-1, 2)]
        graph = build_markov_graph(patches.take(rows), inside[(inside >= 0).all(axis=1)], clique_shares)
        scenes.append(_Scene(graph, patches.label[rows].astype(np.int32)))
    return scenes


train = partial(train_model, slug=SLUG, fit=fit_max_margin)
"""Trains a model on a `PatchTraining` with `MarginParameters`."""
