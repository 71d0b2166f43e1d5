"""Score the visual words on held-out training streets, by weight of the rare streets in threshold selection.

    kedro run --pipelines=yu2016_study --to-nodes=describe_yu2016_objects
    python benchmarks/held_out_streets.py [--weights 0 0.1 0.2 0.5 1] [--divisions 10]

Parameters are chosen here, as the test streets of the study of Yu et al. 2016 are used once. The detector is trained on
all training streets, and each object is scored by the machines trained without its street. The streets that are not
`rare` are repeatedly divided into random halves: thresholds chosen on one half and all rare streets are applied to the
other half. The weight of an object is the `prevalence` of its class in the survey, as training streets contain more
signs than roads; a false positive has weight 1. Recall, precision and F-score are means over divisions, for segmented
objects.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from _common import REPOSITORY
from kedro.framework.session import KedroSession
from kedro.framework.startup import bootstrap_project
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.detection.thresholds import best_threshold, detect_by_thresholds, object_weights
from mlsroad_pipeline.algorithms.visual_words.queries import HeldOut
from mlsroad_pipeline.algorithms.visual_words.training import train_variant
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.pipelines.yu2016_study.pipeline import create_pipeline
from mlsroad_pipeline.studies.yu2016.keys import run_key, street_key
from mlsroad_pipeline.studies.yu2016.parameters import CUT, WORDS
from mlsroad_pipeline.studies.yu2016.plan import StudyPlan, plan_study
from mlsroad_pipeline.studies.yu2016.runs import joint_prevalence

Streets = Sequence[tuple[str, int]]


def stored(*names: str) -> tuple[StudyPlan, *tuple[SceneCollection, ...]]:
    """Return the plan of the study and its stored results of these names."""
    bootstrap_project(REPOSITORY)
    with KedroSession.create(REPOSITORY) as session:
        catalog = session.load_context().catalog
        [planned] = [node for node in create_pipeline().nodes if node.name == "plan_yu2016_study"]
        plan = plan_study(*(catalog.load(name) for name in planned.inputs))
        return plan, *(catalog.load(f"yu2016_study.{name}") for name in names)


def held_out(
    plan: StudyPlan, streets: Streets, segmented: SceneCollection, described: SceneCollection
) -> tuple[HeldOut, NDArray[np.float64]]:
    """Train, and return the held-out scores and the prevalence of classes that thresholds are calibrated to."""
    surveys, classes = plan.scale.surveys, plan.detection.classes
    labels = [segmented.part("classes")[f"{CUT}.{street_key(*street)}"].load() for street in streets]
    usual = {
        run_key(*street): found
        for street, found in zip(streets, labels, strict=True)
        if street[1] not in surveys[street[0]].rare
    }
    known = joint_prevalence(usual, {name: given.prevalence for name, given in surveys.items()}, classes)
    detection = replace(plan.detection, prevalence=known)
    _, detector = train_variant(
        [described.part("parts")[f"{WORDS}.{street_key(*street)}"].load() for street in streets], labels,
        intensity=True, parameters=plan.methods[WORDS], detection=detection,
    )  # fmt: skip
    return detector.held_out_, detection.factors


def detected(
    found: HeldOut, weights: NDArray[np.float64], half: NDArray[np.bool_], rare: NDArray[np.bool_]
) -> NDArray[np.int16]:
    """Return the detections in each half by thresholds chosen on the other half and the rare streets."""
    labels = np.full(len(half), -1, np.int16)
    for one in (True, False):
        rows = rare | (half != one)
        thresholds = [
            best_threshold(found.scores[rows, k], found.labels[rows] == k, weights[rows])[1]
            for k in range(found.scores.shape[1])
        ]
        judged = ~rare & (half == one)
        labels[judged] = detect_by_thresholds(found.scores[judged], np.array(thresholds))[0]
    return labels


def figures(found: HeldOut, labels: NDArray, judged: NDArray[np.bool_], factors: NDArray[np.float64]) -> list[float]:
    """Return recall, precision and F-score of some objects at the prevalence of their survey."""
    weights = object_weights(found.labels, factors) * judged
    wanted = weights[found.labels >= 0].sum()
    right = weights[(found.labels >= 0) & (labels == found.labels)].sum()
    false = (judged & (labels >= 0) & (labels != found.labels)).sum()
    return [right / wanted, right / (right + false), 2 * right / (wanted + right + false)]


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=float, nargs="+", default=[0.0, 0.1, 0.2, 0.5, 1.0], help="of rare streets")
    parser.add_argument("--divisions", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    plan, segmented, described = stored("objects", "described")
    surveys = plan.scale.surveys
    streets = [(name, seed) for name, given in surveys.items() for seed in given.train]
    found, joint = held_out(plan, streets, segmented, described)
    rare = np.array([seed in surveys[name].rare for name, seed in streets])
    survey = np.array([name for name, _ in streets])[found.scenes]
    factors = {name: replace(plan.detection, prevalence=given.prevalence).factors for name, given in surveys.items()}
    odd, rows = rare[found.scenes], []
    for weight in args.weights:
        counted = object_weights(found.labels, joint) * np.where(odd, weight, 1.0)
        rng, reached = np.random.default_rng(args.seed), []
        for _ in range(args.divisions):
            order = rng.permutation(np.flatnonzero(~rare))
            half = np.isin(found.scenes, order[::2])
            labels = detected(found, counted, half, odd)
            reached.append([figures(found, labels, ~odd & (survey == name), own) for name, own in factors.items()])
        by_survey = np.mean(reached, axis=0)
        rows += [(weight, name, *values) for name, values in zip(surveys, by_survey, strict=True)]
        rows.append((weight, "mean", *by_survey.mean(axis=0)))
    print(
        pd.DataFrame(rows, columns=["weight", "survey", "recall", "precision", "f_score"])
        .round(4)
        .to_string(index=False)
    )


if __name__ == "__main__":
    main()
