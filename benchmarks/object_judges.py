"""Train the judge of the inventory's objects on simulated streets labelled by a shipped model.

    python benchmarks/object_judges.py [--folder data/07_model_output/object_judges] [--model pool] [--write]

Simulates the streets of `SURVEYS`, none of which the model was trained on, labels them with it, and makes the
candidates of `algorithms/inventory` on each. Boosted trees classify whether an upright line is a trunk or a pole, and
whether a candidate is an object of its kind. A candidate is true if it lies within the reach of a true object (0.5 m
for poles and signs, 1 m for vehicles and trees), one to one, or if it is the largest piece of a vehicle, moving or
not. Each street is used three times, as labelled and disturbed twice (`judge_streets.py`), and every fourth once more
as a method would label it that gives a class and a confidence, but no probabilities. Vehicles are also learned from
each street with gaps, since scans often show the end of a car alone. Scores are calibrated on folds of streets that
the trees were not trained on. Prints precision, recall and calibration of these folds; with `--write` replaces the
judge of the package and its card. `--model` is a shipped model with class probabilities, or the folder of a model.
Streets are kept in `streets` of the folder, labels and tables in a folder per model: a second run continues where the
first one stopped, and another model labels the same streets.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lightgbm
import numpy as np
import pandas as pd
from judge_candidates import RULES, candidate_table, scene_of
from judge_streets import (
    CLEAN,
    CUT,
    DISTURBED,
    LABELS,
    MODEL,
    MOST_POINTS,
    STREETS,
    SURVEYS,
    Folders,
    Street,
    folders_of,
    prepared,
    read_street,
    seed_of,
    true_objects,
    with_gaps,
)

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.inventory.objects.candidate_table import FEATURE_COLUMNS, raised_labels
from mlsroad_pipeline.algorithms.inventory.objects.object_classifier import (
    NEITHER,
    POLE,
    STEM,
    TRUNK,
    LabelledCandidates,
    ObjectClassifier,
)
from mlsroad_pipeline.algorithms.inventory.objects.object_features import FEATURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, KINDS
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import STEM_FEATURES, find_scene_stems
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.model_store.bundle_files import load_bundle
from mlsroad_pipeline.model_store.object_classifiers import CARD, CLASSIFIER, FOLDER, write_candidate_replay
from mlsroad_pipeline.model_store.shipped_models import FOLDER as MODELS

FOLDS = 5
TREES = {
    "num_leaves": 8, "learning_rate": 0.06, "min_child_samples": 15, "feature_fraction": 0.4, "bagging_fraction": 0.8,
    "bagging_freq": 1, "lambda_l2": 10.0, "extra_trees": True, "max_bin": 127, "verbose": -1, "num_threads": 1,
    "seed": 1, "deterministic": True, "force_row_wise": True,
}  # fmt: skip
REPLAYED = 1500  # candidates of each kind that `mlsroad learn` trains on beside the answers
ROUNDS = {STEM: 120, "pole": 200, "sign": 200, "vehicle": 200, "tree": 200}
POLES = [TAXONOMY[name] for name, kind in KIND_OF_CLASS.items() if kind in ("pole", "sign")]
GROUPS_OF_VARIANTS = {"as labelled": (CLEAN,), "disturbed": DISTURBED, "labels alone": (LABELS,), "with gaps": (CUT,)}
CUT_KIND = "vehicle"
TRUNKS = [TAXONOMY[name] for name in ("trunk", "tree", "palm")]


def stem_table(street: Street) -> pd.DataFrame:
    """Return the features of the stems of a street, and what each is."""
    labels = raised_labels(street.evidence, RULES)
    used = [label for rule in RULES.values() if rule.kind != "vehicle" for label in rule.labels]
    points = np.flatnonzero(np.isin(labels, used))
    stems = find_scene_stems(street.local, street.height, points, scene_of(street).cells)
    table = pd.DataFrame(stems.features, columns=list(STEM_FEATURES))
    inside = stems.owner >= 0
    true, n = street.truth[points[inside]], len(table)
    size = np.maximum(np.bincount(stems.owner[inside], minlength=n), 1)
    trunk = np.bincount(stems.owner[inside], weights=np.isin(true, TRUNKS), minlength=n) / size
    pole = np.bincount(stems.owner[inside], weights=np.isin(true, POLES), minlength=n) / size
    return table.assign(target=np.where(trunk > 0.5, TRUNK, np.where(pole > 0.4, POLE, NEITHER)), street=street.name)


def fit(
    table: pd.DataFrame, target: np.ndarray, classifier: str, seed: int = 1, weight: np.ndarray | None = None
) -> BoostedTrees:
    """Train the trees of a classifier."""
    several = classifier == STEM
    parameters = {
        **TREES,
        "seed": seed,
        **({"objective": "multiclass", "num_class": 3} if several else {"objective": "binary"}),
    }
    # The scores begin at 0, which keeps the trees independent of the library's own start.
    data = lightgbm.Dataset(table.to_numpy(np.float32), target, weight=weight, params={"max_bin": TREES["max_bin"]})
    booster = lightgbm.train({**parameters, "boost_from_average": False}, data, ROUNDS[classifier])
    return BoostedTrees.from_lightgbm(booster.model_to_string())


def folds_of(streets: pd.Series) -> np.ndarray:
    """Return the fold of each row: whole streets."""
    number = {street: i % FOLDS for i, street in enumerate(sorted(streets.unique()))}
    return streets.map(number).to_numpy()


def held_out_scores(table: pd.DataFrame, target: np.ndarray, streets: pd.Series, classifier: str) -> np.ndarray:
    """Return the scores of each row by trees that were trained on other streets."""
    fold = folds_of(streets)
    out = np.zeros((len(table), 3 if classifier == STEM else 1))
    for k in range(FOLDS):
        out[fold == k] = fit(table[fold != k], target[fold != k], classifier).scores(
            table[fold == k].to_numpy(np.float32)
        )
    return out


def calibrated(scores: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """Return factor and summand of logistic calibration, by Newton's method."""
    a, b = 1.0, 0.0
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-(a * scores + b)))
        w = np.maximum(p * (1.0 - p), 1e-9)
        gradient = np.array([(scores * (p - target)).sum() + 1e-3 * (a - 1.0), (p - target).sum()])
        hessian = np.array([[(w * scores**2).sum() + 1e-3, (w * scores).sum()], [(w * scores).sum(), w.sum()]])
        a, b = np.array([a, b]) - np.linalg.solve(hessian, gradient)
    return float(a), float(b)


def medians(values: np.ndarray) -> np.ndarray:
    """Return the medians of columns, NaN where a column has no value."""
    known = ~np.isnan(values).all(axis=0)
    out = np.full(values.shape[1], np.nan, np.float32)
    out[known] = np.nanmedian(values[:, known], axis=0)
    return out


def stem_judge(stems: pd.DataFrame) -> ObjectClassifier:
    """Train the judge of stems, and print its scores on folds that it was not trained on."""
    table, target = stems[list(STEM_FEATURES)], stems["target"].to_numpy()
    scores = held_out_scores(table, target, stems["street"], STEM)
    powers = np.exp(scores - scores.max(axis=1, keepdims=True))
    p = powers / powers.sum(axis=1, keepdims=True)
    for name, column, least in (("trunk", TRUNK, 0.5), ("pole", POLE, 0.6)):
        chosen, right = p[:, column] > least, target == column
        figures = {"precision": right[chosen].mean(), "recall": chosen[right].mean()}
        line = {"classifier": STEM, "class": name, "stems": len(target)}
        print(json.dumps(line | {k: round(float(v), 3) for k, v in figures.items()}), flush=True)
    typical = medians(table.to_numpy(np.float32))
    return ObjectClassifier(
        {STEM: STEM_FEATURES}, {STEM: fit(table, target, STEM)}, {STEM: (1.0, 0.0)}, {STEM: typical}
    )


def learned_rows(candidates: pd.DataFrame, kind: str) -> pd.DataFrame:
    """Return the candidates of a kind that its judge learns from; those of streets with gaps are vehicles alone."""
    own = (candidates["kind"] == kind) & ~candidates["ignored"].astype(bool)
    return candidates[own & ((kind == CUT_KIND) | (candidates["variant"] != CUT))]


def kind_judge(
    candidates: pd.DataFrame, judge: ObjectClassifier, n_true: dict[str, dict[str, int]]
) -> tuple[ObjectClassifier, dict[str, dict[str, dict[str, float]]]]:
    """Add the judges of the kinds; return also the figures of held-out streets by group of variants and kind."""
    parts = [dict(value) for value in (judge.features, judge.trees, judge.calibration, judge.typical)]
    figures: dict[str, dict[str, dict[str, float]]] = {group: {} for group in GROUPS_OF_VARIANTS}
    for kind in KINDS:
        rows = learned_rows(candidates, kind)
        table = rows[list(FEATURE_COLUMNS)]
        target = rows["true"].to_numpy(float)
        scores = held_out_scores(table, target, rows["street"], kind)[:, 0]
        a, b = calibrated(scores, target)
        false = table.to_numpy(np.float32)[target == 0]
        for part, value in zip(parts, (FEATURES, fit(table, target, kind), (a, b), medians(false)), strict=True):
            part[kind] = value
        held = rows[["true"]].assign(score=1 / (1 + np.exp(-(a * scores + b))))
        for group, variants in GROUPS_OF_VARIANTS.items():
            mine = rows["variant"].isin(variants)
            if not mine.any():
                continue
            figures[group][kind] = held_out_figures(held[mine], sum(n_true[v].get(kind, 0) for v in variants))
            print(json.dumps({"classifier": kind, "streets": group, **figures[group][kind]}), flush=True)
    return ObjectClassifier(*parts), figures


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


def card(
    figures: dict[str, dict[str, dict[str, float]]], n_streets: int, n_simulated: int, options: argparse.Namespace
) -> str:
    """Return the card of the judge."""
    lines = [
        "# Classifier of objects",
        "",
        "Boosted trees that give the objects of an inventory their scores, and tell trunks from poles. MIT licence.",
        f"Trained on {n_streets} simulated streets of {len(STREETS)} kinds (of {n_simulated}: those with at most",
        f"{MOST_POINTS:,} points), labelled by the shipped model `{options.model}`, which was not trained on them.",
        "Each street was used three times: as labelled, and twice with noise in its class probabilities, sheared, with",
        "leaning poles, and with some poles labelled tree and some trunks labelled pole. Vehicles were also learned",
        "from each street with gaps that cut them. Moving vehicles are true objects here,",
        "although most are stretched by their motion and cannot be found whole.",
        "No recording was trained on. That poles lean and are labelled tree was seen on Oakland.",
        f"Seeds {', '.join(str(c['seed']) for c in SURVEYS.values())}; scanners",
        f"{', '.join(sorted({preset for c in SURVEYS.values() for preset in c['presets']}))}.",
        "",
        "Candidates of streets that the trees were not trained on (five folds of streets):",
        "",
        "| streets | kind | true | candidates | precision at 0.4 | recall at 0.4 | F at 0.4 | calibration error |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for group, kinds in figures.items():
        for kind, row in kinds.items():
            shown = [f"{row['true_objects']:.0f}", f"{row['candidates']:.0f}"]
            names = ("precision_at_0.4", "recall_at_0.4", "f_at_0.4", "calibration_error")
            shown += [f"{row[name]:.2f}" for name in names]
            lines.append(f"| {group} | {kind} | {' | '.join(shown)} |")
    command = f"python benchmarks/object_judges.py --model {options.model} --thirds {options.thirds} --write"
    return "\n".join([*lines, "", f"Made by `{command}`.", ""])


def variants_of(number: int) -> tuple[str, ...]:
    """Return the variants of a street that are used, by its number."""
    return (CLEAN, *DISTURBED, CUT, LABELS) if number % 4 == 0 else (CLEAN, *DISTURBED, CUT)


def tables(names: list[str], folders: Folders, what: str, make: Any, *, cut: bool = True) -> Iterator[pd.DataFrame]:
    """Yield a table per street and variant, those with gaps if `cut`; stored tables are read."""
    for i, name in enumerate(names):
        for variant in variants_of(i):
            if variant == CUT and not cut:
                continue
            path = folders.labelled / f"{what}_{name}_{variant}.parquet"
            if not path.exists():
                street = read_street(name, folders, variant)
                table = pd.DataFrame() if street is None else make(street)
                table.assign(variant=variant).to_parquet(path)
            yield pd.read_parquet(path)


def stem_version(judge: ObjectClassifier) -> str:
    """Return a digest of the trees that classify stems, on which the candidates depend."""
    arrays = judge.trees[STEM].to_arrays().values()
    return hashlib.sha256(b"".join(np.ascontiguousarray(values).tobytes() for values in arrays)).hexdigest()[:8]


def count_true(names: list[str], folders: Folders) -> dict[str, dict[str, int]]:
    """Return the number of true objects per variant and kind, with the moving vehicles."""
    counts: dict[str, dict[str, int]] = {v: dict.fromkeys(KINDS, 0) for v in (CLEAN, *DISTURBED, CUT, LABELS)}
    for i, name in enumerate(names):
        whole = read_street(name, folders)
        if whole is None:
            continue
        truth = {CLEAN: true_objects(whole), CUT: true_objects(with_gaps(whole, seed_of(name, CUT)))}
        for variant in variants_of(i):
            own = truth[CUT if variant == CUT else CLEAN]
            there = own["counted"] | (own["enough"] & (own["kind"] == "vehicle"))
            for kind, n in own.loc[there, "kind"].value_counts().items():
                counts[variant][str(kind)] += int(n)
    return counts


def main() -> None:
    """Simulate, train, print; write the judge if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("data/07_model_output/object_judges"))
    parser.add_argument("--model", default=MODEL)
    parser.add_argument("--thirds", type=int, default=3, choices=(1, 2, 3), help="thirds of the streets that are used")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    shipped = MODELS / options.model
    bundle = load_bundle(shipped if shipped.is_dir() else Path(options.model))
    folders = folders_of(options.folder, bundle)
    names = prepared(folders, bundle, options.thirds)
    judge = stem_judge(pd.concat(tables(names, folders, "stems", stem_table, cut=False), ignore_index=True))
    what = f"candidates_{stem_version(judge)}"
    found = [table for table in tables(names, folders, what, lambda s: candidate_table(s, judge)) if len(table)]
    candidates = pd.concat(found, ignore_index=True)
    judge, figures = kind_judge(candidates, judge, count_true(names, folders))
    np.savez_compressed(folders.labelled / CLASSIFIER, **judge.to_arrays())
    if options.write:
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / CLASSIFIER).write_bytes((folders.labelled / CLASSIFIER).read_bytes())
        write_candidate_replay(replay_of(candidates))
        used = candidates["street"].nunique()
        (FOLDER / CARD).write_text(card(figures, used, len(names), options), encoding="utf-8")
        print(f"written: {FOLDER / CLASSIFIER}, {FOLDER / CARD}")


if __name__ == "__main__":
    main()
