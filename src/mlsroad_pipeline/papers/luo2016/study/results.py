"""Tables of the study of Luo et al. 2016, made from the results of its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.scores import ALL, check_scores
from mlsroad_pipeline.papers.luo2016.study.objects import StreetCounts
from mlsroad_pipeline.papers.luo2016.study.paper import CLASSES, HOURS, OBJECTS, table_one_of_paper
from mlsroad_pipeline.papers.luo2016.study.parameters import METHODS, PRINTED_REFINED, REFINED
from mlsroad_pipeline.papers.luo2016.study.plan import StudyPlan, StudyRun
from mlsroad_pipeline.papers.luo2016.study.runs import RunResult
from mlsroad_pipeline.papers.luo2016.study.scores import (
    MEANS,
    all_pairs,
    paired_differences,
    repetition_scores,
    sensitivity_table,
    table_three,
    times_table,
)
from mlsroad_pipeline.papers.shared.studies.tables import Tables

Results = Mapping[str, RunResult]
"""Key of a run to its result."""

PREDICTED = {"shape_based": OBJECTS}
"""Classes of a method that predicts only some: shape-based recognition does not label the ground."""


@dataclass(frozen=True)
class StudyTables(Tables):
    """Tables of the study."""

    scores: pd.DataFrame  # table of scores; its splits are the test streets, ``mean_f1`` is over seven classes
    table_3: pd.DataFrame  # precision, recall and F1 of each method and class, mean and spread over test streets
    differences: pd.DataFrame  # mean F1 of each method minus that of `patch_graph_mrf`, paired by test street
    pairs: pd.DataFrame  # difference of mean F1 of every two methods, paired by test street
    table_1: pd.DataFrame  # points, objects and touching objects of each class in all streets, and in the paper
    # patch_size, search_radius: F1, training time and objective by parameter value, mean and spread over test streets
    patch_size: pd.DataFrame
    search_radius: pd.DataFrame
    times: pd.DataFrame  # CPU time of training and labelling of each method
    tuning: pd.DataFrame  # `method`, `setting`, `mean_f1` on training streets, `chosen`
    # by_size, by_radius: metrics by step, in millimetres of patch size and of search radius
    by_size: pd.DataFrame
    by_radius: pd.DataFrame


def study_tables(plan: StudyPlan, streets: Mapping[str, StreetCounts], tried: Results, results: Results) -> StudyTables:
    """Make the tables."""
    parameters = plan.tuned(tried)
    classes = plan.scheme.classes
    matrices: dict[str, dict[str, NDArray[np.int64]]] = {}
    facts = []
    for run in plan.comparison_runs(parameters):
        result = results[run.key]
        for place, seed in enumerate(run.test):
            here = {method: counts[place] for method, counts in result["matrices"].items()}
            matrices.setdefault(f"test_{seed}", {}).update(here)
        per_street = result["facts"]["label_seconds"] / len(run.test)
        facts.append(result["facts"].assign(label_seconds=per_street))
    ordered = {street: {m: each[m] for m in METHODS} for street, each in matrices.items()}
    scores = repetition_scores(ordered, classes=classes, given=PREDICTED)
    times = times_table(pd.concat(facts, ignore_index=True)).set_index("method").reindex(list(METHODS)).reset_index()
    hours = pd.DataFrame(HOURS, index=["paper_train_hours", "paper_label_hours"]).T
    size = _sensitivity(plan.size_runs(parameters), results, classes, REFINED)
    radius = _sensitivity(plan.radius_runs(parameters), results, classes, PRINTED_REFINED)
    return StudyTables(
        scores=scores_frame(scores, ordered, classes),
        table_3=table_three(scores),
        differences=paired_differences(scores),
        pairs=all_pairs(scores),
        table_1=table_one(list(streets.values()), classes),
        patch_size=size,
        search_radius=radius,
        times=times.merge(hours, left_on="method", right_index=True, how="left"),
        tuning=_tuning(plan, tried),
        by_size=by_step(size, "patch_size"),
        by_radius=by_step(radius, "search_radius"),
    )


def _sensitivity(
    runs: Mapping[float, Sequence[StudyRun]], results: Results, classes: Sequence[str], method: str
) -> pd.DataFrame:
    """Score a method at every value, over the test streets of all runs of the value."""
    matrices: dict[float, dict[str, dict[str, NDArray[np.int64]]]] = {}
    facts: dict[float, pd.DataFrame] = {}
    for value, repetitions in runs.items():
        if not repetitions:
            continue
        found = [(run, results[run.key]) for run in repetitions]
        matrices[value] = {
            f"test_{seed}": {method: result["matrices"][method][place]}
            for run, result in found
            for place, seed in enumerate(run.test)
        }
        facts[value] = pd.concat([facts_of(result, method) for _, result in found])
    return sensitivity_table(matrices, facts, classes=classes)


def facts_of(result: RunResult, method: str) -> pd.DataFrame:
    """Return the facts of one method of a run."""
    facts = result["facts"]
    return facts[facts["method"] == method]


def table_one(streets: Sequence[StreetCounts], classes: Sequence[str]) -> pd.DataFrame:
    """Return the points and objects of all streets by class beside Table I of the paper."""
    kinds = ("points", "objects", "touching")
    totals = {kind: np.sum([street[kind] for street in streets], axis=0) for kind in kinds}  # type: ignore[literal-required]  # mypy reads no tuple of names
    table = pd.DataFrame({"class": list(classes), **totals})
    table["share"] = table["points"] / table["points"].sum()
    paper = table_one_of_paper()
    paper["paper_share"] = paper["paper_points"] / paper["paper_points"].sum()
    return table.merge(paper, on="class", how="left")


def scores_frame(
    scores: pd.DataFrame, matrices: Mapping[str, Mapping[str, NDArray[np.int64]]], classes: Sequence[str]
) -> pd.DataFrame:
    """Convert scores of `repetition_scores` to the common table of scores."""
    support = {
        (repetition, method): dict(zip(classes, matrix.sum(axis=1).tolist(), strict=True))
        for repetition, methods in matrices.items()
        for method, matrix in methods.items()
    }
    rows = []
    for repetition, method, name, metric, value in scores.itertuples(index=False, name=None):
        counts = support[repetition, method]
        if name in CLASSES:
            rows.append((method, repetition, name, metric, value, counts[name]))
        elif (name, metric) == ("mean of seven", "f1"):
            rows.append((method, repetition, ALL, "mean_f1", value, sum(counts[c] for c in CLASSES)))
    columns = ["method", "split", "class", "metric", "value", "support"]
    return check_scores(pd.DataFrame(rows, columns=columns))


def by_step(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Convert a table of `sensitivity_table` to metrics by step in millimetres."""
    steps = (1000 * table["value"]).round().astype(np.int64)
    kept = table[[*MEANS, "train_seconds", "objective"]].astype(np.float64).dropna(axis="columns")
    kept.columns = [f"{name}_{str(column).replace(' ', '_')}" for column in kept.columns]
    return pd.concat([steps.rename("millimetres"), kept], axis=1)


def _tuning(plan: StudyPlan, tried: Results) -> pd.DataFrame:
    chosen = plan.tuned(tried)
    rows = [
        {
            "method": run.method,
            "setting": ", ".join(f"{key} {value}" for key, value in _setting(plan, run).items()),
            "mean_f1": plan.tuning_score(run, tried[run.key]["matrices"]),
            "chosen": run.parameters[run.method] == chosen[run.method],
        }
        for run in plan.tuning_runs()
    ]
    return pd.DataFrame(rows, columns=["method", "setting", "mean_f1", "chosen"])


def _setting(plan: StudyPlan, run: StudyRun) -> Mapping[str, Any]:
    number = int(run.key.rpartition("_")[2])
    return plan.scale.tuning[run.method][number]
