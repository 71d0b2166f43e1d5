"""Train the regression by which the pool divides the ground into paved and natural ground by colour.

    python benchmarks/ground_colour.py [--streets 48] [--write]

Simulates streets of eleven kinds by five presets with colours, none of which a model of the package was trained on,
and labels them with the pool. The terms of the regression are computed three times for each street: with its own
colours, and with two other drawings of asphalt, paving, dry grass, shade and camera (`ground_colours.py`). Each street
has the same weight. Prints F1 of natural ground of streets that were held out (four folds), with their own and with
other colours, and the weights. `--write` stores the weights in the pool of the package, whose labels
`benchmarks/shipped_models.py --predictions tests/datasets/models/predictions` then writes anew for the tests.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from ground_colours import recoloured
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.machines.combinations import decide
from mlsroad_pipeline.algorithms.models.pool.labeller import (
    INTERCEPT,
    SLUG,
    TERMS,
    PooledVoxels,
    ground_classes,
    ground_terms,
    members_of,
    natural_share,
    pooled_voxels,
    with_ground_colour,
)
from mlsroad_pipeline.model_store.shipped_models import load_shipped, save_shipped, shipped_models
from mlsroad_pipeline.simulation import simulate_survey
from mlsroad_pipeline.simulation.parameters.presets import simulation_parameters

KINDS = ("residential", "old_town", "american_suburb", "downtown", "town", "suburb", "industrial", "rural",
         "asian_arterial", "campus", "ring_road")  # fmt: skip
SCANNED = ("town", "suburb", "rural", "american_suburb")
LINES, SCANS = ("small", "small", "demo", "tiny"), ("hdl64", "pandaset")
VARIANTS, FOLDS = 2, 4
LEAST_POINTS = 2000
"""Natural points of a street below which its F1 is left out of the means."""


def streets(number: int) -> list[dict[str, Any]]:
    """Return the surveys to simulate: a sixth are single scans, the others line scanners on a vehicle."""
    n_scans = number // 6
    scan = {"length": 96, "speed": 20, "scan_spacing": 16}
    scans = [{"preset": SCANS[k % 2], "seed": 9300 + k, "street": SCANNED[k // 2 % 4], **scan} for k in range(n_scans)]
    lines = [
        {"preset": LINES[k % 4], "seed": 9200 + k, "street": KINDS[k % 11], "length": 60}
        for k in range(number - n_scans)
    ]
    return [*scans, *lines]


class Ground(NamedTuple):
    """Ground of a street, or of some voxels of it.

    Attributes
    ----------
    terms : ndarray of float64, shape (k, terms)
        Terms of the regression of voxels with colour.
    paved, natural : ndarray of float64, shape (k,)
        Points of the voxels by their true class.
    points : ndarray of float64, shape (k,)
        All points of the voxels, including those of other classes.
    rest : ndarray of float64, shape (3,)
        True positives, false positives and false negatives of natural ground outside these voxels.
    before : ndarray of bool, shape (k,)
        Voxels that the pool labels natural ground without colour.
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


def prepare(config: dict[str, Any], bundle: ModelBundle) -> list[Ground]:
    """Simulate and label a street, and return its ground with its own colours and with others."""
    cloud = simulate_survey(simulation_parameters(config)).cloud
    truth = bundle_scheme(bundle).encode(cloud["label"])
    pooled = pooled_voxels(cloud, bundle)
    if pooled is None:
        raise SystemExit(f"{config}: the pool labels no point")
    probabilities, owner, _ = pooled
    labels, _ = decide(probabilities, next(iter(members_of(bundle).values())).arrays.get("groups"))
    on_ground = np.flatnonzero((owner >= 0) & np.isin(labels[owner], ground_classes(bundle.classes)))
    found = []
    for variant in range(1 + VARIANTS):
        rgb = cloud["rgb"].copy()
        if variant:
            rng = np.random.default_rng([config["seed"], variant])
            rgb[on_ground] = recoloured(cloud.xyz[on_ground], rgb[on_ground], cloud["label"][on_ground], rng)
        found.append(ground_of(pooled, labels, truth, rgb, ground_classes(bundle.classes)))
    return found


def ground_of(
    pooled: PooledVoxels, labels: NDArray[np.integer], truth: NDArray[np.integer], rgb: NDArray[np.uint8],
    pair: tuple[int, int],
) -> Ground:  # fmt: skip
    """Return the ground of a labelled cloud with the true classes of its points, -1 for none, and their colours."""
    probabilities, owner, region = pooled
    known = owner >= 0
    paved, natural, points = (
        np.bincount(owner[known & chosen], minlength=len(labels)).astype(np.float64)
        for chosen in (truth == pair[0], truth == pair[1], truth >= 0)
    )
    rows, terms = ground_terms(probabilities, labels, pair, rgb, owner, region)
    others = np.ones(len(labels), np.bool_)
    others[rows] = False
    named = others & (labels == pair[1])
    rest = [natural[named].sum(), (points - natural)[named].sum(), natural[others & ~named].sum()]
    table = np.stack([terms[name] for name in TERMS], axis=1)
    return Ground(table, paved[rows], natural[rows], points[rows], np.array(rest), labels[rows] == pair[1])


def fit(grounds: list[Ground]) -> dict[str, float]:
    """Return the weights of the regression, rounded; each ground has the same weight."""
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
    weights = dict(zip(TERMS, regression.coef_[0] / spread, strict=True))
    return {name: round(float(value), 2) for name, value in {**weights, INTERCEPT: regression.intercept_[0]}.items()}


def held_out(surveys: list[list[Ground]]) -> None:
    """Print the mean F1 of natural ground of streets that the regression was not trained on."""
    rows: list[list[float]] = []
    for fold in range(FOLDS):
        weights = fit([one for k, street in enumerate(surveys) if k % FOLDS != fold for one in street])
        for street in surveys[fold::FOLDS]:
            if street[0].natural.sum() < LEAST_POINTS:
                continue
            after = [one.f1(share_of(one, weights) > 0.5) for one in street]
            rows.append([street[0].f1(street[0].before), after[0], float(np.mean(after[1:]))])
    names = ("without colour", "own colours", "other colours")
    figures = ", ".join(
        f"{name} {mean:.3f} ({least:.3f})"
        for name, mean, least in zip(names, np.mean(rows, axis=0), np.min(rows, axis=0), strict=True)
    )
    print(f"F1 of natural ground on {len(rows)} held-out streets, mean (least): {figures}")


def share_of(ground: Ground, weights: dict[str, float]) -> NDArray[np.float64]:
    """Return the share of natural ground of the voxels."""
    return natural_share(dict(zip(TERMS, ground.terms.T, strict=True)), weights)


def write(bundle: ModelBundle, weights: dict[str, float]) -> None:
    """Store the weights in the pool of the package, whose entry then names colour."""
    entry = shipped_models()[SLUG]
    metadata = {key: value for key, value in bundle.metadata.items() if key != "shipped"}
    attributes = tuple(dict.fromkeys((*entry.attributes, "rgb")))
    coloured = with_ground_colour(replace(bundle, metadata=metadata), weights)
    save_shipped(coloured, replace(entry, attributes=attributes))


def main() -> None:
    """Train, print, and write what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--streets", type=int, default=48)
    parser.add_argument("--write", action="store_true", help="store the weights in the pool of the package")
    options = parser.parse_args()
    bundle = load_shipped(SLUG)
    surveys = []
    for config in streets(options.streets):
        surveys.append(prepare(config, bundle))
        f1 = surveys[-1][0].f1(surveys[-1][0].before)
        print(f"{config['preset']} {config['street']} {config['seed']}: without colour {f1:.3f}", flush=True)
    held_out(surveys)
    weights = fit([one for street in surveys for one in street])
    print(weights)
    if options.write:
        write(bundle, weights)


if __name__ == "__main__":
    main()
