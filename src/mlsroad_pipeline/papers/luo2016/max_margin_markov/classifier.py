"""Max-margin Markov networks (Munoz, Bagnell, Vandapel and Hebert 2009), a baseline of Luo et al. 2016 (section IV-C).

The score of a labelling is the sum of scores of sites, pairs and cliques, which functional gradient boosting learns.
"""

import logging
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least, check_positive
from mlsroad_pipeline.papers.luo2016.max_margin_markov.network import (
    PARTS,
    MarkovGraph,
    MarkovNetwork,
    build_markov_graph,
    clique_shares,
)
from mlsroad_pipeline.papers.shared.patches.table import Patches, edges_between

SLUG = "max_margin_markov"

_EXPONENTS = {"balanced": 1.0, "sqrt": 0.5, "none": 0.0}

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class MarginParameters:
    """Parameters of the network and of its training."""

    n_rounds: int = 40  # Trees of each kind. More trees fit the training scenes better; time grows linearly.
    step: float = 1.0  # Factor of the first tree; round t divides it by the square root of t
    site_depth: int = 8  # Maximum depth of the trees of sites
    context_depth: int = 3  # Maximum depth of the trees of pairs and cliques
    min_samples_leaf: int = 10  # Minimum rows per leaf
    # Patches per round: scenes are added until this number is reached. Larger rounds are steadier and slower.
    batch_patches: int = 20_000
    fit_rows: int = 10_000  # Sites, pairs or cliques per tree, sampled by weight. Time grows with it.
    # Total weight of a class: equal for all classes, the square root of its patches, or their number
    class_weight: str = "sqrt"
    # Clusters of each k-means segmentation as a fraction of the patches (luo2016: 0.03, 0.01); empty for no cliques
    clique_shares: Sequence[float] = field(default_factory=lambda: [0.03, 0.01])
    truncation: float = 0.3  # Fraction of deviating members at which the score of a clique reaches 0, at most 0.5
    temperature: float = 1.0  # Divisor of the scores in the conversion to probabilities
    seed: int = 2009  # Seed of the order of scenes, of the samples and of ties in trees

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


def _gradient(scene: _Scene, predicted: NDArray[np.int32], network: MarkovNetwork) -> dict[str, NDArray[np.float64]]:
    """Return the functional gradient at each site, pair and clique."""
    graph, truth, eye = scene.graph, scene.truth, np.eye(network.n_labels)
    ends = graph.edges
    gradient = {"sites": eye[truth] - eye[predicted], "pairs": np.zeros((len(ends), network.n_labels))}
    for labels, sign in ((truth, 1.0), (predicted, -1.0)):
        agree = labels[ends[:, 0]] == labels[ends[:, 1]]
        gradient["pairs"][agree] += sign * eye[labels[ends[agree, 0]]]
    true, found = (clique_shares(graph, y, network.n_labels, network.truncation) for y in (truth, predicted))
    gradient["groups"] = true - found
    return gradient


def _rounds(scenes: Sequence[_Scene], batch_patches: int, n_rounds: int, seed: int) -> list[list[_Scene]]:
    """Assign scenes to rounds; each pass over all scenes has a new random order."""
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
    """Add one tree of each kind; return the fraction of wrong sites in the loss-augmented labelling."""
    gradients: dict[str, list[NDArray]] = {part: [] for part in PARTS}
    rows: dict[str, list[NDArray]] = {part: [] for part in PARTS}
    counts: dict[str, list[NDArray]] = {part: [] for part in PARTS}
    wrong = 0

    def search(scene: _Scene) -> NDArray[np.int32]:
        bonus = 1.0 - np.eye(network.n_labels)[scene.truth]
        return network.best_labels(scene.graph, network.potentials(scene.graph), bonus)

    for scene, predicted in zip(batch, pool.map(search, batch), strict=True):
        wrong += int((predicted != scene.truth).sum())
        for part, gradient in _gradient(scene, predicted, network).items():
            gradients[part].append(gradient)
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
            np.concatenate(gradients[part])[drawn],
            np.ones(len(drawn)),
            step=p.step / np.sqrt(round_number + 1.0),
            max_depth=p.site_depth if part == "sites" else p.context_depth,
            min_samples_leaf=p.min_samples_leaf,
            seed=p.seed + len(PARTS) * round_number + number,
        )
    return wrong / sum(len(scene.truth) for scene in batch)


def _split(patches: Patches, edges: NDArray[np.int32], clique_shares: Sequence[float]) -> list[_Scene]:
    """Split the training set into scenes and build the graph of each."""
    scenes = []
    for number in np.unique(patches.scene):
        rows = patches.scene == number
        graph = build_markov_graph(patches.take(rows), edges_between(edges.reshape(-1, 2), rows), clique_shares)
        scenes.append(_Scene(graph, patches.label[rows].astype(np.int32)))
    return scenes


@dataclass(frozen=True, eq=False)
class MaxMarginMarkov:
    """Patch classifier with a max-margin Markov network."""

    network: MarkovNetwork
    clique_shares: Sequence[float]  # see `MarginParameters`
    temperature: float
    colour: NDArray[np.float32]  # mean colour of training, for patches without colour; empty without colour
    errors: Sequence[float]  # share of wrong sites in the loss-augmented labelling of each round

    @classmethod
    def fit(
        cls,
        patches: Patches,
        edges: NDArray[np.int32],
        *,
        n_classes: int,
        parameters: MarginParameters | None = None,
        n_threads: int = 1,
    ) -> Self:
        """Train a max-margin Markov network on labelled patches."""
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
            raise DataError(
                f"all training patches are of class {int(sizes.argmax())}: training needs at least two classes"
            )
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
        return cls(network, p.clique_shares, p.temperature, colour.astype(np.float32), errors)

    def predict_proba(self, patches: Patches, edges: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return class probabilities."""
        if len(patches) == 0:
            return np.zeros((0, self.network.n_labels))
        if len(self.colour) == 0:
            patches = patches.with_columns(rgb=None)
        elif patches.rgb is None:
            patches = patches.with_columns(rgb=np.tile(self.colour, (len(patches), 1)))
        graph = build_markov_graph(patches, edges, self.clique_shares)
        return self.network.conditional_probabilities(graph, self.temperature)

    def to_arrays(self) -> dict[str, NDArray]:
        """Return the learned parameters as named arrays."""
        return {
            **self.network.to_arrays(),
            "clique_shares": np.array(self.clique_shares),
            "temperature": np.array(self.temperature),
            "colour": self.colour,
            "errors": np.array(self.errors),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Rebuild a classifier from the arrays of `to_arrays`."""
        return cls(
            MarkovNetwork.from_arrays(arrays),
            arrays["clique_shares"].tolist(),
            float(arrays["temperature"]),
            arrays["colour"],
            arrays["errors"].tolist(),
        )
