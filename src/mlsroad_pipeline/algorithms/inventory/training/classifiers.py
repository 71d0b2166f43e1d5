"""Boosted trees of the object classifier, trained and calibrated on candidates of simulated streets."""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import FEATURE_COLUMNS
from mlsroad_pipeline.algorithms.inventory.objects.measured_rows import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import (
    POLE,
    STEM,
    TRUNK,
    LabelledCandidates,
    ObjectClassifier,
)
from mlsroad_pipeline.algorithms.inventory.objects.plates import PLATE, PLATE_FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KINDS
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES
from mlsroad_pipeline.algorithms.inventory.training.streets import CLEAN, CUT, DISTURBED, LABELS, RECORDED
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees

log = logging.getLogger(__name__)

FOLDS = 5
TREES = {
    "num_leaves": 8, "learning_rate": 0.06, "min_child_samples": 15, "feature_fraction": 0.4, "bagging_fraction": 0.8,
    "bagging_freq": 1, "lambda_l2": 10.0, "extra_trees": True, "max_bin": 127, "verbose": -1, "num_threads": 1,
    "seed": 1, "deterministic": True, "force_row_wise": True, "boost_from_average": False,
}  # fmt: skip
"""Settings of LightGBM. The scores begin at 0, which keeps the trees independent of the library's own start."""

REPLAYED = 1500
"""Candidates of each kind that `mlsroad learn` trains on beside the answers."""

ROUNDS = {STEM: 120, PLATE: 120, "pole": 200, "sign": 200, "vehicle": 200, "tree": 200}
GROUPS_OF_VARIANTS = {
    "as labelled": (CLEAN,),
    "disturbed": DISTURBED,
    "labels alone": (LABELS,),
    "with gaps": (CUT,),
    "recordings": (RECORDED,),
}
CUT_KIND = "vehicle"

Figures = dict[str, dict[str, dict[str, float]]]
"""Scores of held-out streets by group of variants and kind."""


def part_classifier(stems: pd.DataFrame, plates: pd.DataFrame) -> ObjectClassifier:
    """Train the classifiers of stems and of plates, and log their scores on streets that they were not trained on."""
    values, target = stems[list(STEM_FEATURES)], stems["target"].to_numpy()
    scores = held_out_scores(values, target, stems["street"], STEM)
    powers = np.exp(scores - scores.max(axis=1, keepdims=True))
    p = powers / powers.sum(axis=1, keepdims=True)
    for name, column, least in (("trunk", TRUNK, 0.5), ("pole", POLE, 0.6)):
        _log_part(f"{name} among {len(target)} stems", p[:, column] > least, target == column)
    shape, true = plates[list(PLATE_FEATURES)], plates["target"].to_numpy(float)
    raw = held_out_scores(shape, true, plates["street"], PLATE)[:, 0]
    a, b = calibrated(raw, true)
    _log_part(f"signs among {len(true)} pieces", expit(a * raw + b) > 0.3, true > 0)
    return ObjectClassifier(
        {STEM: STEM_FEATURES, PLATE: PLATE_FEATURES},
        {STEM: fit(values, target, STEM), PLATE: fit(shape, true, PLATE)},
        {STEM: (1.0, 0.0), PLATE: (a, b)},
        {STEM: medians(values.to_numpy(np.float32)), PLATE: medians(shape.to_numpy(np.float32)[true == 0])},
    )


def _log_part(what: str, chosen: NDArray[np.bool_], right: NDArray[np.bool_]) -> None:
    precision, recall = (float(np.sum(chosen & right)) / max(int(part.sum()), 1) for part in (chosen, right))
    log.info("%s: precision %.3f, recall %.3f", what, precision, recall)


def kind_classifiers(
    candidates: pd.DataFrame, parts_known: ObjectClassifier, n_true: Mapping[tuple[str, str], int]
) -> tuple[ObjectClassifier, Figures]:
    """Add the classifiers of the kinds to those of stems and plates; return also the scores of held-out streets.

    `n_true` has the number of true objects by variant and kind.
    """
    parts: list[dict[str, Any]] = [
        dict(value) for value in (parts_known.features, parts_known.trees, parts_known.calibration, parts_known.typical)
    ]
    figures: Figures = {group: {} for group in GROUPS_OF_VARIANTS}
    for kind in KINDS:
        rows = learned_rows(candidates, kind)
        table = rows[list(FEATURE_COLUMNS)]
        target = rows["true"].to_numpy(float)
        scores = held_out_scores(table, target, rows["street"], kind)[:, 0]
        a, b = calibrated(scores, target)
        false = table.to_numpy(np.float32)[target == 0]
        for part, value in zip(parts, (FEATURES, fit(table, target, kind), (a, b), medians(false)), strict=True):
            part[kind] = value
        held = rows[["true"]].assign(score=expit(a * scores + b))
        for group, variants in GROUPS_OF_VARIANTS.items():
            mine = rows["variant"].isin(variants)
            if mine.any():
                number = sum(n_true.get((variant, kind), 0) for variant in variants)
                figures[group][kind] = held_out_figures(held[mine], number)
    return ObjectClassifier(*parts), figures


def fit(
    table: pd.DataFrame, target: NDArray, classifier: str, weight: NDArray[np.float64] | None = None
) -> BoostedTrees:
    """Train the trees of a classifier."""
    import lightgbm  # noqa: PLC0415  # labelling needs none

    parameters = TREES | (
        {"objective": "multiclass", "num_class": 3} if classifier == STEM else {"objective": "binary"}
    )
    data = lightgbm.Dataset(table.to_numpy(np.float32), target, weight=weight, params={"max_bin": TREES["max_bin"]})
    booster = lightgbm.train(parameters, data, ROUNDS[classifier])
    return BoostedTrees.from_lightgbm(booster.model_to_string())


def folds_of(streets: pd.Series) -> NDArray:
    """Return the fold of each row: whole streets."""
    number = {street: i % FOLDS for i, street in enumerate(sorted(streets.unique()))}
    return streets.map(number).to_numpy()


def held_out_scores(table: pd.DataFrame, target: NDArray, streets: pd.Series, classifier: str) -> NDArray:
    """Return the scores of each row by trees that were trained on other streets."""
    fold = folds_of(streets)
    out = np.zeros((len(table), 3 if classifier == STEM else 1))
    for k in np.unique(fold):
        out[fold == k] = fit(table[fold != k], target[fold != k], classifier).scores(
            table[fold == k].to_numpy(np.float32)
        )
    return out


def calibrated(scores: NDArray, target: NDArray) -> tuple[float, float]:
    """Return factor and summand of logistic calibration; a small penalty keeps the factor near 1 where data are few."""

    def loss(weights: NDArray) -> tuple[float, NDArray]:
        z = weights[0] * scores + weights[1]
        error = expit(z) - target
        gradient = np.array([(scores * error).sum() + 1e-3 * (weights[0] - 1.0), error.sum() + 1e-6 * weights[1]])
        penalty = 5e-4 * (weights[0] - 1.0) ** 2 + 5e-7 * weights[1] ** 2
        return float((np.logaddexp(0.0, z) - target * z).sum() + penalty), gradient

    a, b = minimize(loss, np.array([1.0, 0.0]), jac=True, method="L-BFGS-B").x
    return float(a), float(b)


def medians(values: NDArray) -> NDArray:
    """Return the medians of columns, NaN where a column has no value."""
    known = ~np.isnan(values).all(axis=0)
    out = np.full(values.shape[1], np.nan, np.float32)
    out[known] = np.nanmedian(values[:, known], axis=0)
    return out


def learned_rows(candidates: pd.DataFrame, kind: str) -> pd.DataFrame:
    """Return the training candidates of a kind; those of streets with gaps are vehicles alone."""
    own = (candidates["kind"] == kind) & ~candidates["ignored"].astype(bool)
    return candidates[own & ((kind == CUT_KIND) | (candidates["variant"] != CUT))]


def held_out_figures(rows: pd.DataFrame, n_true: int) -> dict[str, float]:
    """Return precision, recall and F at the best threshold and at 0.4, and the expected calibration error."""
    p, y = rows["score"].to_numpy(), rows["true"].to_numpy(bool)

    def at(least: float) -> tuple[float, float, float]:
        n, right = int((p >= least).sum()), int(y[p >= least].sum())
        return right / max(n, 1), right / max(n_true, 1), 2 * right / max(n + n_true, 1)

    best = max(np.arange(0.05, 0.95, 0.05), key=lambda least: at(least)[2])
    bins = np.minimum((p * 10).astype(int), 9)
    error = sum(
        abs(p[bins == k].mean() - y[bins == k].mean()) * (bins == k).mean() for k in range(10) if (bins == k).any()
    )
    names = ("precision", "recall", "f")
    figures = {"candidates": len(p), "true_objects": n_true, "found": int(y.sum()), "best_threshold": best}
    figures |= dict(zip(names, at(best), strict=True)) | dict(zip([f"{n}_at_0.4" for n in names], at(0.4), strict=True))
    return {k: round(float(v), 3) for k, v in {**figures, "calibration_error": error}.items()}


def replay_of(candidates: pd.DataFrame) -> dict[str, LabelledCandidates]:
    """Draw the candidates of each kind that `mlsroad learn` replays."""
    found = {}
    for kind in KINDS:
        rows = learned_rows(candidates, kind)
        drawn = rows.sample(min(REPLAYED, len(rows)), random_state=2026)
        found[kind] = LabelledCandidates(
            drawn[list(FEATURE_COLUMNS)].to_numpy(np.float32), drawn["true"].to_numpy(bool)
        )
    return found
