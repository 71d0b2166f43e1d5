"""From the results of all runs of the study of Luo et al. 2016 to its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.scores import ALL, check_scores
from mlsroad_pipeline.studies.luo2016.paper import CLASSES, HOURS, OBJECTS
from mlsroad_pipeline.studies.luo2016.parameters import METHODS, REFINED
from mlsroad_pipeline.studies.luo2016.plan import StudyPlan, StudyRun
from mlsroad_pipeline.studies.luo2016.scores import (
    MEANS,
    paired_differences,
    repetition_scores,
    sensitivity_table,
    table_three,
    times_table,
)
from mlsroad_pipeline.studies.tables import Tables

Results = Mapping[str, Mapping[str, Any]]
"""Key of a run to what `train_and_score` gave."""

GIVEN = {"shape_based": OBJECTS}
"""Shape-based recognition leaves the ground without labels: a dash in Table III."""


@dataclass(frozen=True)
class StudyTables(Tables):
    """The tables of the study.

    Parameters
    ----------
    scores : DataFrame
        A table of scores; its splits are the repetitions, ``mean_f1`` is over seven classes.
    table_3, differences, patch_size, search_radius, times : DataFrame
        What the functions of `luo2016` give.
    tuning : DataFrame
        `method`, `setting`, `mean_f1` on training streets, `chosen`.
    by_size, by_radius : DataFrame
        Figures by step, in whole millimetres of patch size and of search radius.
    """

    scores: pd.DataFrame
    table_3: pd.DataFrame
    differences: pd.DataFrame
    patch_size: pd.DataFrame
    search_radius: pd.DataFrame
    times: pd.DataFrame
    tuning: pd.DataFrame
    by_size: pd.DataFrame
    by_radius: pd.DataFrame


def study_tables(plan: StudyPlan, tried: Results, results: Results) -> StudyTables:
    """Make the tables."""
    parameters = plan.tuned(tried)
    classes = plan.scheme.classes
    matrices: dict[str, dict[str, NDArray[np.int64]]] = {}
    facts = []
    for run in plan.comparison_runs(parameters):
        result = results[run.key]
        for place, seed in enumerate(run.test):
            found_here = {method: counts[place] for method, counts in result["matrices"].items()}
            matrices.setdefault(f"test_{seed}", {}).update(found_here)
        per_street = result["facts"]["label_seconds"] / len(run.test)
        facts.append(result["facts"].assign(label_seconds=per_street))
    ordered = {r: {m: found[m] for m in METHODS} for r, found in matrices.items()}
    found = repetition_scores(ordered, classes=classes, given=GIVEN)
    times = times_table(pd.concat(facts, ignore_index=True)).set_index("method").reindex(list(METHODS)).reset_index()
    hours = pd.DataFrame(HOURS, index=["paper_train_hours", "paper_label_hours"]).T
    size = _sensitivity(plan.size_runs(parameters), results, classes)
    radius = _sensitivity(plan.radius_runs(parameters), results, classes)
    return StudyTables(
        scores=scores_frame(found, ordered, classes),
        table_3=table_three(found),
        differences=paired_differences(found),
        patch_size=size,
        search_radius=radius,
        times=times.merge(hours, left_on="method", right_index=True, how="left"),
        tuning=_tuning(plan, tried),
        by_size=by_step(size, "patch_size"),
        by_radius=by_step(radius, "search_radius"),
    )


def _sensitivity(runs: Mapping[float, StudyRun], results: Results, classes: Sequence[str]) -> pd.DataFrame:
    found = {value: results[run.key] for value, run in runs.items()}
    matrices = {
        value: {str(place): {REFINED: counts} for place, counts in enumerate(result["matrices"][REFINED])}
        for value, result in found.items()
    }
    facts = {value: result["facts"].query("method == @REFINED") for value, result in found.items()}
    return sensitivity_table(matrices, facts, classes=classes)


def scores_frame(
    found: pd.DataFrame, matrices: Mapping[str, Mapping[str, NDArray[np.int64]]], classes: Sequence[str]
) -> pd.DataFrame:
    """Turn the scores of the repetitions into a table of scores."""
    support = {
        (repetition, method): dict(zip(classes, matrix.sum(axis=1).tolist(), strict=True))
        for repetition, methods in matrices.items()
        for method, matrix in methods.items()
    }
    rows = []
    for repetition, method, name, metric, value in found.itertuples(index=False, name=None):
        counts = support[repetition, method]
        if name in CLASSES:
            rows.append((method, repetition, name, metric, value, counts[name]))
        elif (name, metric) == ("mean of seven", "f1"):
            rows.append((method, repetition, ALL, "mean_f1", value, sum(counts[c] for c in CLASSES)))
    columns = ["method", "split", "class", "metric", "value", "support"]
    return check_scores(pd.DataFrame(rows, columns=columns))


def by_step(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Turn a table of `sensitivity_table` into figures by step."""
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
