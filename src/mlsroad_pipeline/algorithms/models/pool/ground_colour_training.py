"""Training of the regression by which the pool divides the ground into paved and natural ground by colour.

The terms of the regression are computed three times for each street: with its own colours, and with two other drawings
of asphalt, paving, dry grass, shade and camera. Each street has the same weight.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.machines.combinations import decide
from mlsroad_pipeline.algorithms.models.pool import labeller

NATURAL = [TAXONOMY[name] for name in ("grass", "soil", "trail")]
GAMMA = 2.2
WEIGHTS = np.array([0.3, 0.6, 0.1])  # of the channels in the luminance
BRICK = np.array([0.35, 0.0, -0.4])  # logarithms of the channels of reddish paving against grey
BLUE = np.array([-0.5, 0.0, 0.6])  # the same of light from the sky alone
STRAW = np.array([0.36, 0.29, 0.15])  # linear colour of dry grass


def recoloured(
    xyz: NDArray[np.floating], rgb: NDArray[np.uint8], code: NDArray[np.integer], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return other colours of points; black points, which no camera saw, stay black and others do not become so."""
    light = (rgb / 255.0) ** GAMMA
    seen: NDArray[np.bool_] = np.asarray(rgb.any(axis=1))
    if rng.random() < 0.4:  # camera and scanner are not aligned
        _, other = cKDTree(xyz).query(xyz + np.append(rng.normal(0, 0.12, 2), 0))
        light, seen = light[other], seen[other]
    for one in np.unique(code):
        own = code == one
        vary = _natural if one in NATURAL else _paved
        light[own] = vary(light[own], xyz[own, :2], rng, road=one == TAXONOMY["road"])
    if rng.random() < 0.6:  # shade of trees and houses
        shaded = smooth_noise(xyz[:, :2], rng, rng.uniform(3, 15)) > rng.uniform(-0.3, 1.2)
        light[shaded] *= rng.uniform(0.12, 0.5) * np.exp(rng.uniform(0, 0.5) * BLUE)
    if rng.random() < 0.25:  # the cameras see one side
        angle = rng.uniform(0, 2 * np.pi)
        across = (xyz[:, :2] - xyz[:, :2].mean(axis=0)) @ [np.cos(angle), np.sin(angle)]
        seen = seen & (across <= rng.uniform(-10, 10))
    return np.where(seen[:, None], _photographed(light, rng), 0).astype(np.uint8)


def _paved(light: NDArray, xy: NDArray, rng: np.random.Generator, *, road: bool) -> NDArray:
    """Return paving of another tone and hue; other paving than roads is reddish or ochre in a third of the streets."""
    light = light * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.08, 3))
    return light if road or rng.random() > 0.3 else light * np.exp(rng.uniform(0.3, 1) * BRICK)


def _natural(light: NDArray, xy: NDArray, rng: np.random.Generator, *, road: bool) -> NDArray:
    """Return grass or soil that is dry in places."""
    straw = STRAW * np.exp(rng.normal(0, 0.12, 3))
    dry = np.clip(rng.uniform(-0.4, 0.7) + 0.35 * smooth_noise(xy, rng, rng.uniform(2, 15)), 0, 0.95)[:, None]
    withered = (light @ WEIGHTS)[:, None] * (straw / (straw @ WEIGHTS)) * rng.uniform(0.8, 1.6)
    return ((1 - dry) * light + dry * withered) * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.06, 3))


def _photographed(light: NDArray, rng: np.random.Generator) -> NDArray:
    """Return the values, 1 to 255, of a camera: exposure, white balance, saturation, tone curve and noise."""
    light = light * np.exp(rng.normal(-0.1, 0.35)) * np.exp(rng.normal(0, 0.1, 3))
    grey = light.mean(axis=1, keepdims=True)
    light = np.clip(grey + (light - grey) * rng.uniform(0.35, 1.4), 0, 1)
    values = 255 * light ** (1 / rng.uniform(1.6, 2.6))
    values = values * np.exp(rng.normal(0, rng.uniform(0, 0.05), light.shape))
    return np.clip(np.rint(values + rng.normal(0, rng.uniform(0, 4), light.shape)), 1, 255)


def smooth_noise(xy: NDArray[np.floating], rng: np.random.Generator, scale: float) -> NDArray[np.float64]:
    """Return noise of unit variance that changes within some `scale` metres."""
    waves = rng.normal(0, np.pi / scale, (6, 2))
    return np.cos(xy.astype(np.float64) @ waves.T + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1) / np.sqrt(3)


VARIANTS, FOLDS = 2, 4
LEAST_POINTS = 2000
"""Natural points of a street below which its F1 is left out of the means."""


class Ground(NamedTuple):
    """Ground of a street, or of some of its voxels: regression terms and true points of the voxels with colour.

    `rest` has true positives, false positives and false negatives of natural ground outside these voxels; `before`
    marks those that the pool labels natural ground without colour.
    """

    terms: NDArray[np.float64]
    paved: NDArray[np.float64]
    natural: NDArray[np.float64]
    points: NDArray[np.float64]
    rest: NDArray[np.float64]
    before: NDArray[np.bool_]

    def f1(self, found: NDArray[np.bool_]) -> float:
        """Return F1 of natural ground over all points."""
        right, wrong = self.natural[found].sum(), (self.points - self.natural)[found].sum()
        counts = self.rest + np.array([right, wrong, self.natural[~found].sum()])
        return float(2 * counts[0] / max(2 * counts[0] + counts[1] + counts[2], 1))


def grounds_of(cloud: PointCloud, bundle: ModelBundle, seed: int) -> list[Ground]:
    """Return the ground of a simulated street that the pool labels, with its own colours and with others."""
    truth = bundle_scheme(bundle).encode(cloud["label"])
    pooled = labeller.pooled_voxels(cloud, bundle)
    if pooled is None:
        raise DataError(f"{cloud.source}: the pool labels no point")
    probabilities, owner, _ = pooled
    labels, _ = decide(probabilities, next(iter(labeller.members_of(bundle).values())).arrays.get("groups"))
    pair = labeller.ground_classes(bundle.classes)
    on_ground = np.flatnonzero((owner >= 0) & np.isin(labels[owner], pair))
    found = []
    for variant in range(1 + VARIANTS):
        rgb = cloud["rgb"].copy()
        if variant:
            rng = np.random.default_rng([seed, variant])
            rgb[on_ground] = recoloured(cloud.xyz[on_ground], rgb[on_ground], cloud["label"][on_ground], rng)
        found.append(ground_of(pooled, labels, truth, rgb, pair))
    return found


def ground_of(
    pooled: labeller.PooledVoxels, labels: NDArray[np.integer], truth: NDArray[np.integer], rgb: NDArray[np.uint8],
    pair: tuple[int, int],
) -> Ground:  # fmt: skip
    """Return the ground of a labelled cloud with the true classes of its points, -1 for none, and their colours."""
    probabilities, owner, region = pooled
    known = owner >= 0
    paved, natural, points = (
        np.bincount(owner[known & chosen], minlength=len(labels)).astype(np.float64)
        for chosen in (truth == pair[0], truth == pair[1], truth >= 0)
    )
    rows, terms = labeller.ground_terms(probabilities, labels, pair, rgb, owner, region)
    others = np.ones(len(labels), np.bool_)
    others[rows] = False
    named = others & (labels == pair[1])
    rest = [natural[named].sum(), (points - natural)[named].sum(), natural[others & ~named].sum()]
    table = np.stack([terms[name] for name in labeller.TERMS], axis=1)
    return Ground(table, paved[rows], natural[rows], points[rows], np.array(rest), labels[rows] == pair[1])


def fit(grounds: Sequence[Ground]) -> dict[str, float]:
    """Return the weights of the regression, rounded; each ground has the same weight."""
    from sklearn.linear_model import LogisticRegression  # noqa: PLC0415  # slow to import

    terms = np.concatenate([one.terms for one in grounds for _ in range(2)])
    truth = np.concatenate([np.repeat([1, 0], len(one.terms)) for one in grounds])
    sizes = [max((one.natural + one.paved).sum(), 1) for one in grounds]
    weight = np.concatenate(
        [np.append(one.natural, one.paved) / size for one, size in zip(grounds, sizes, strict=True)]
    )
    used = weight > 0
    spread = terms[used].std(axis=0)
    regression = LogisticRegression(C=10.0, max_iter=1000, tol=1e-6)
    regression.fit(terms[used] / spread, truth[used], sample_weight=weight[used])
    weights = dict(zip(labeller.TERMS, regression.coef_[0] / spread, strict=True))
    return {
        name: round(float(value), 2)
        for name, value in {**weights, labeller.INTERCEPT: regression.intercept_[0]}.items()
    }


def held_out_f1(surveys: Sequence[Sequence[Ground]]) -> NDArray[np.float64]:
    """Return F1 of natural ground of each street, by weights trained on the other folds of streets.

    The columns are F1 without colour, with the colours of the street, and the mean of F1 with other colours. Streets
    with little natural ground are left out.
    """
    rows: list[list[float]] = []
    for fold in range(min(FOLDS, len(surveys))):
        weights = fit([one for k, street in enumerate(surveys) if k % FOLDS != fold for one in street])
        for street in surveys[fold::FOLDS]:
            if street[0].natural.sum() < LEAST_POINTS:
                continue
            after = [one.f1(_share_of(one, weights) > 0.5) for one in street]
            rows.append([street[0].f1(street[0].before), after[0], float(np.mean(after[1:]))])
    return np.reshape(rows, (-1, 3))


def _share_of(ground: Ground, weights: dict[str, float]) -> NDArray[np.float64]:
    """Return the share of natural ground of the voxels."""
    return labeller.natural_share(dict(zip(labeller.TERMS, ground.terms.T, strict=True)), weights)
