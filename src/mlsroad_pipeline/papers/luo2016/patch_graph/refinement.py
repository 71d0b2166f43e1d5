"""Refinement of transferred labels by a Markov random field (Luo et al. 2016, section III-D).

Higher-order cliques are the patches of separate objects and of columns around masts (robust P^n Potts model).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_column
from mlsroad_pipeline.algorithms.energy import robust_potts
from mlsroad_pipeline.algorithms.energy.alpha_expansion import minimize
from mlsroad_pipeline.algorithms.energy.robust_potts import Cliques
from mlsroad_pipeline.algorithms.geometry.graphs import connected_components
from mlsroad_pipeline.algorithms.metrics.confusion import confusion_matrix, scores

BAND = (1.0, 2.5)
"""Heights above ground at which masts are looked for, metres: above plants and below crowns."""

WIDTH, EXTENT = 0.7, 1.0
"""Largest horizontal and least vertical extent of a mast in that band, metres."""

LEAST_IN_BAND = 4
"""Fewest patches of a mast in that band."""


def separate_masts(
    component: NDArray[np.integer],
    positions: NDArray[np.floating],
    edges: NDArray[np.int32],
    above: NDArray[np.bool_],
    *,
    radius: float,
) -> NDArray[np.int64]:
    """Divide components at their masts: the patches within a radius of the axis of a mast are a component of their own.

    A mast is a narrow upright cluster between 1.0 and 2.5 m above ground. It stays with its component if its column
    holds half of the component or more, as the mast of a lamp that stands alone.
    """
    n, height = len(component), positions[:, 2]
    divided = component.astype(np.int64)
    band = above & (height >= BAND[0]) & (height <= BAND[1])
    clusters = connected_components(edges[band[edges].all(axis=1)], n_nodes=n)
    members = _groups(component, above)
    for mast in _groups(clusters, band).values():
        extent = np.ptp(positions[mast], axis=0)
        if len(mast) < LEAST_IN_BAND or extent[:2].max() > WIDTH or extent[2] < EXTENT:
            continue
        own = members[int(component[mast[0]])]
        offset = positions[own, :2] - np.median(positions[mast, :2], axis=0)
        column = own[(offset**2).sum(axis=1) <= radius**2]
        if len(column) < 0.5 * len(own):
            divided[column] = n + clusters[mast[0]]
    return divided


def _groups(number: NDArray[np.integer], chosen: NDArray[np.bool_]) -> dict[int, NDArray[np.int64]]:
    """Return the chosen patches of each number."""
    rows = np.flatnonzero(chosen)
    rows = rows[np.argsort(number[rows], kind="stable")]
    numbers, starts = np.unique(number[rows], return_index=True)
    return dict(zip(numbers.tolist(), np.split(rows, starts[1:]), strict=True)) if len(rows) else {}


LEAST_PATCHES = 4
"""Fewest patches of a clique."""


@dataclass(frozen=True)
class GroundClasses:
    """Ground classes with special weights in equation 11."""

    # grass, road: labels, possibly equal; -1 if the scheme lacks the class
    grass: int = -1
    road: int = -1


def object_cliques(
    labels: NDArray[np.integer],
    edges: NDArray[np.int32],
    n_classes: int,
    *,
    ground: GroundClasses,
    weight: float,
    truncation: float,
    positions: NDArray[np.floating] | None = None,
    mast_radius: float = 0.0,
) -> Cliques:
    """Return a clique for each connected component of the patches that are neither grass nor road."""
    n = len(labels)
    rows = np.flatnonzero((labels != ground.grass) & (labels != ground.road))
    above = np.zeros(n, np.bool_)
    above[rows] = True
    number = connected_components(edges[above[edges].all(axis=1)], n_nodes=n).astype(np.int64)
    if mast_radius > 0:
        if positions is None:
            raise ParameterError("mast_radius needs the positions of the patches")
        number = separate_masts(number, positions, edges, above, radius=mast_radius)
    component = np.unique(number[rows], return_inverse=True)[1]
    sizes = np.bincount(component)
    ordered = np.argsort(component, kind="stable")
    large = sizes >= LEAST_PATCHES
    members = rows[ordered][large[component[ordered]]].astype(np.int32)
    counts = sizes[large]
    return Cliques(
        np.concatenate([[0], np.cumsum(counts)]),
        members,
        np.zeros((len(counts), n_classes)),
        np.multiply(counts, weight, dtype=np.float64),
        np.multiply(counts, truncation, dtype=np.float64),
    )


def clique_support(cliques: Cliques, labels: NDArray[np.integer], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return what each label saves a patch in its clique, given the labels of the others."""
    support = np.zeros(shape)
    owner = np.repeat(np.arange(len(cliques)), np.diff(cliques.indptr))
    counts = np.zeros((len(cliques), shape[1]))
    np.add.at(counts, (owner, labels[cliques.members]), 1.0)
    most = counts.argmax(axis=1) if len(cliques) else np.zeros(0, np.int64)
    deviating = np.diff(cliques.indptr) - counts.max(axis=1, initial=0.0)
    rate = np.where(deviating < cliques.truncation, cliques.maximum / cliques.truncation, 0.0)
    support[cliques.members, most[owner]] = rate[owner]
    return support


CRITERIA = ("mean_f1", "overall_accuracy")
"""Criteria of `choose_parameters`."""


@dataclass(frozen=True)
class RefinementParameters:
    """Parameters of the Markov random field."""

    smoothness: float = 1.0  # Lambda of equation 9; larger values give smoother labels
    # Beta of equation 11, the decay of edge weights with the squared difference of the colours in [0, 1]. Without
    # colour such edges have weight 1.
    colour_decay: float = 10.0
    # Gamma of equation 11, the weight of edges from grass or road to other classes (luo2016: 0)
    ground_penalty: float = 0.0
    # Lower bound of the probability in equation 10: a class without votes costs 1 - log(floor). Larger values allow
    # neighbours to introduce classes without votes.
    floor: float = 0.01
    # Whether edges within grass and within road are smoothed like all others. As printed, equation 11 gives them the
    # weight `ground_penalty`; with 0, patches at the border of grass and road are attracted by the other class only.
    smooth_ground: bool = False
    # Maximum cost of an object clique per patch (see `object_cliques`); 0 for no cliques (luo2016: none). Larger values
    # give the patches of a separate object one label.
    clique_weight: float = 0.0
    # Share of deviating patches at which a clique has its maximum cost. Smaller values keep the minority in objects
    # that touch.
    clique_truncation: float = 0.3
    # Radius of columns around masts that are cliques of their own (see `separate_masts`), metres; 0 for none. A radius
    # keeps lamps that stand in trees.
    mast_radius: float = 0.0

    def __post_init__(self) -> None:
        for name in ("smoothness", "colour_decay", "ground_penalty", "clique_weight", "mast_radius"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise ParameterError(f"{name} must be a finite number >= 0, got {getattr(self, name)!r}")
        if not 0 < self.floor < 1:
            raise ParameterError(f"floor must be in (0, 1), got {self.floor!r}")
        if not 0 < self.clique_truncation <= 0.5:
            raise ParameterError(f"clique_truncation must be in (0, 0.5], got {self.clique_truncation!r}")


def edge_weights(
    labels: NDArray[np.integer],
    rgb: NDArray[np.float32] | None,
    edges: NDArray[np.int32],
    *,
    parameters: RefinementParameters,
    ground: GroundClasses,
) -> NDArray[np.float64]:
    """Return the weight of each edge, the cost of different labels at its ends (equation 11).

    The penalty for grass and road applies if either order of the ends meets the printed condition. Each edge thus has
    one weight, which depends only on the initial labels.
    """
    if rgb is None:
        weights = np.ones(len(edges))
    else:
        squared = ((rgb[edges[:, 0]] - rgb[edges[:, 1]]).astype(np.float64) ** 2).sum(axis=1)
        weights = np.exp(-parameters.colour_decay * squared)
    a, b = labels[edges[:, 0]], labels[edges[:, 1]]
    for u, v in ((a, b), (b, a)):
        for kept, exchanged in ((ground.grass, ground.road), (ground.road, ground.grass)):
            other = (v != exchanged) & ~((v == kept) & parameters.smooth_ground)
            weights[(kept >= 0) & (u == kept) & other] = parameters.ground_penalty
    return weights


def refine(
    probabilities: NDArray[np.floating],
    rgb: NDArray[np.float32] | None,
    edges: NDArray[np.int32],
    *,
    parameters: RefinementParameters | None = None,
    ground: GroundClasses | None = None,
    positions: NDArray[np.floating] | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Refine labels by alpha-expansion of the energy of equations 9 to 11, with object cliques if chosen."""
    chosen = parameters or RefinementParameters()
    if rgb is not None:
        check_column(rgb, len(probabilities), "rgb", 3)
    initial = probabilities.argmax(axis=1).astype(np.int32)
    weights = chosen.smoothness * edge_weights(initial, rgb, edges, parameters=chosen, ground=ground or GroundClasses())
    unary = 1.0 - np.log(np.maximum(probabilities, chosen.floor))
    kept = weights > 0
    if chosen.clique_weight > 0:
        cliques = object_cliques(
            initial, edges, unary.shape[1], ground=ground or GroundClasses(), weight=chosen.clique_weight,
            truncation=chosen.clique_truncation, positions=positions, mast_radius=chosen.mast_radius,
        )  # fmt: skip
        labels, _ = robust_potts.minimize(unary, edges[kept], weights[kept], cliques, initial=initial)
        unary = unary - clique_support(cliques, labels, unary.shape)
    else:
        labels, _ = minimize(unary, edges[kept], weights[kept], initial=initial)
    return labels, _conditional(unary, edges[kept], weights[kept], labels)


def _conditional(
    unary: NDArray[np.float64], edges: NDArray[np.int32], weights: NDArray[np.float64], labels: NDArray[np.int32]
) -> NDArray[np.float64]:
    n, n_classes = unary.shape
    energy = unary.copy()
    for u, v in ((edges[:, 0], edges[:, 1]), (edges[:, 1], edges[:, 0])):
        agreeing = np.bincount(u * np.int64(n_classes) + labels[v], weights=weights, minlength=n * n_classes)
        energy -= agreeing.reshape(n, n_classes)
    energy -= energy.min(axis=1, keepdims=True)
    # The refined label takes precedence in ties and rounding differences.
    energy[np.arange(n), labels] = -1e-9
    shares: NDArray[np.float64] = np.exp(-energy)
    return shares / shares.sum(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class ValidationScene:
    """Training scene labelled by matches in other training scenes."""

    probabilities: NDArray[np.floating]  # Class probabilities of the patches
    rgb: NDArray[np.float32] | None  # Colours of the patches
    edges: NDArray[np.int32]  # Pairs of adjacent patches
    labels: NDArray[np.int16]  # True classes of the patches
    positions: NDArray[np.floating] | None = None  # x, y and height above ground of the patches, metres


def choose_parameters(
    scenes: Sequence[ValidationScene],
    *,
    smoothness: Sequence[float],
    colour_decay: Sequence[float],
    clique_weight: Sequence[float] = (0.0,),
    criterion: str = "mean_f1",
    base: RefinementParameters | None = None,
    ground: GroundClasses | None = None,
) -> tuple[RefinementParameters, list[dict[str, float]]]:
    """Choose lambda, beta and the weight of object cliques by grid search on held-out scenes."""
    if criterion not in CRITERIA:
        raise ParameterError(f"criterion must be one of {list(CRITERIA)}, got {criterion!r}")
    if not scenes or not smoothness or not colour_decay or not clique_weight:
        raise ParameterError("a grid search needs at least one scene and one value of each parameter")
    rest = base or RefinementParameters()
    decays = colour_decay if all(scene.rgb is not None for scene in scenes) else colour_decay[:1]
    tried: list[RefinementParameters] = []
    grid: list[dict[str, float]] = []
    for weight, decay, clique in product(smoothness, decays, clique_weight):
        parameters = replace(rest, smoothness=weight, colour_decay=decay, clique_weight=clique)
        total = np.zeros((scenes[0].probabilities.shape[1],) * 2, np.int64)
        for scene in scenes:
            labels, _ = refine(
                scene.probabilities, scene.rgb, scene.edges, parameters=parameters, ground=ground,
                positions=scene.positions,
            )  # fmt: skip
            total += confusion_matrix(scene.labels, labels, len(total))[:, : len(total)]
        tried.append(parameters)
        quality = {name: float(getattr(scores(total), name)) for name in CRITERIA}
        grid.append({"smoothness": weight, "colour_decay": decay, "clique_weight": clique, **quality})
    best = max(range(len(grid)), key=lambda place: grid[place][criterion])
    return tried[best], grid
