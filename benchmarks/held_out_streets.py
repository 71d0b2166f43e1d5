"""Score a detector on training streets that it has not learned from, by how much the rare ones count in thresholds.

    kedro run --pipeline=yu2016_study --to-nodes=describe_yu2016_objects
    python benchmarks/held_out_streets.py [--method visual_words] [--folds 4] [--jobs 2]

The test streets of the study of Yu et al. 2016 are for one look; what is to be chosen is tried here. Each fold of the
training streets is held out in turn, a model learns from the others as in the study, thresholds included, and detects
in those that are held out and not `rare`. Examples count by the `prevalence` of their survey, as training streets have
more signs than roads have; a false detection counts once.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import chain
from typing import Any

import joblib
import numpy as np
import pandas as pd
from cut_intensity import stored

from mlsroad_pipeline.algorithms.studies.yu2016 import counts_of
from mlsroad_pipeline.algorithms.studies.yu2016_parameters import CUT, DETECTORS, WORDS
from mlsroad_pipeline.algorithms.studies.yu2016_results import StudyPlan, run_key, street_key
from mlsroad_pipeline.algorithms.studies.yu2016_runs import train_and_detect
from mlsroad_pipeline.datasets.scene_collection import SceneCollection

Streets = Sequence[tuple[str, int]]


def detect_in(
    fold: Streets,
    others: Streets,
    *,
    plan: StudyPlan,
    stores: Sequence[SceneCollection],
    method: str,
    rare: dict[str, float],
) -> list[dict[str, Any]]:
    """Learn from some streets and detect in others: one row per street and class."""
    streets, segmented, described = stores

    def parts(survey: str, seed: int) -> Any:
        return described.part("parts")[f"{method}.{street_key(survey, seed)}"].load()

    train, test = {}, {}
    for survey, seed in others:
        classes = segmented.part("classes")[f"{CUT}.{street_key(survey, seed)}"].load()
        train[run_key(survey, seed)] = {"parts": parts(survey, seed), "classes": classes}
    for survey, seed in fold:
        key = street_key(survey, seed)
        scene = (streets.part("points")[key], segmented.part("objects")[f"{CUT}.{key}"])
        test[run_key(survey, seed)] = {"parts": parts(survey, seed), "scene": scene}
    found = train_and_detect(
        train, test, method=method, parameters=plan.methods[method], stages=plan.stages, detection=plan.detection,
        scheme=plan.scheme, prevalence={name: given.prevalence for name, given in plan.scale.surveys.items()},
        rare=rare,
    )  # fmt: skip
    rows = []
    for survey, seed in fold:
        for number, name in enumerate(plan.detection.classes):
            counts = counts_of(found[run_key(survey, seed)], [number])
            rows.append({"survey": survey, "class": name, "tp": counts.tp, "fp": counts.fp, "fn": counts.fn})
    return rows


def figures(table: pd.DataFrame, plan: StudyPlan) -> pd.DataFrame:
    """Return recall, precision and F-score of each survey and class, and of all classes by their prevalence."""
    rows = []
    for survey, own in table.groupby("survey"):
        total = own.groupby("class", sort=False)[["tp", "fp", "fn"]].sum()
        factor = np.array([plan.scale.surveys[survey].prevalence.get(name, 1.0) for name in total.index])
        weighed = total * np.column_stack([factor, np.ones_like(factor), factor])  # what is false counts once
        for name, (tp, fp, fn) in [*total.iterrows(), ("all", weighed.sum())]:
            rows.append((survey, name, tp, fp, fn, tp / (tp + fn), tp / (tp + fp), 2 * tp / (2 * tp + fp + fn)))
    return pd.DataFrame(rows, columns=["survey", "class", "tp", "fp", "fn", "recall", "precision", "f_score"])


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default=WORDS, choices=DETECTORS)
    parser.add_argument("--folds", type=int, default=4)
    parser.add_argument("--weights", type=float, nargs="+", default=[0.0, 0.5, 1.0], help="of the rare streets")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    plan, *stores = stored("streets", "objects", "described")
    surveys = plan.scale.surveys
    usual = [(name, seed) for name, given in surveys.items() for seed in given.train if seed not in given.rare]
    rare = [(name, seed) for name, given in surveys.items() for seed in given.rare]
    work = []
    for weight in args.weights:
        for k in range(args.folds):
            fold = usual[k :: args.folds]
            others = [street for street in (*usual, *rare) if street not in fold]
            weights = {run_key(*street): weight for street in rare}
            work.append(joblib.delayed(detect_in)(
                fold, others, plan=plan, stores=stores, method=args.method, rare=weights))  # fmt: skip
    found = joblib.Parallel(n_jobs=args.jobs)(work)
    for place, weight in enumerate(args.weights):
        rows = found[place * args.folds : (place + 1) * args.folds]
        print(f"\nObjects of rare streets count {weight:g} in thresholds\n")
        print(figures(pd.DataFrame(list(chain.from_iterable(rows))), plan).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
