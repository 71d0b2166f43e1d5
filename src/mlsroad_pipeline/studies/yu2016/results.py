"""From the results of all runs of the study of Yu et al. 2016 to its tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.detection.detector import DetectionStages
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters, detection_table
from mlsroad_pipeline.studies.tables import Tables, mean_and_spread
from mlsroad_pipeline.studies.yu2016 import paper as yu2016_paper
from mlsroad_pipeline.studies.yu2016 import scores as yu2016
from mlsroad_pipeline.studies.yu2016.parameters import CUT, DETECTORS, WORDS, StudyScale

Results = Mapping[str, Mapping[str, Any]]
"""Key of a task to what it gave."""

SEGMENTATION_FIGURES = (
    "coverage", "weighted_coverage", "touching", "weighted_touching", "precision", "recall", "wanted", "seconds"
)  # fmt: skip


@dataclass(frozen=True)
class StudyPlan:
    """What the study runs.

    Parameters
    ----------
    scale : StudyScale
        Streets and settings.
    detection : DetectionParameters
        The wanted classes.
    scheme : ClassScheme
        The classes.
    stages : DetectionStages
        Ground filter and segmentation.
    methods : mapping
        Slug to the parameters of each detector.
    """

    scale: StudyScale
    detection: DetectionParameters
    scheme: ClassScheme
    stages: DetectionStages
    methods: Mapping[str, Any]


@dataclass(frozen=True)
class StudyTables(Tables):
    """The tables of the study.

    Parameters
    ----------
    scores : DataFrame
        A table of scores; its splits are the surveys.
    segmentation : DataFrame
        Figures of each segmentation and survey, mean over the test streets and spread.
    table_2, table_3, table_4, table_5 : DataFrame
        The paper's tables, with its figures beside ours; table 3 has all detectors.
    differences : DataFrame
        F-score of the other detectors minus that of the visual words, paired by street, for cars and for all classes.
    figure_12, curves : DataFrame
        Settings of the visual words, and their precision-recall curves.
    """

    scores: pd.DataFrame
    segmentation: pd.DataFrame
    table_2: pd.DataFrame
    table_3: pd.DataFrame
    table_4: pd.DataFrame
    table_5: pd.DataFrame
    differences: pd.DataFrame
    figure_12: pd.DataFrame
    curves: pd.DataFrame


def street_key(survey: str, seed: int) -> str:
    """Return the name of a street."""
    return f"{survey}.seed_{seed}"


def run_key(survey: str, seed: int) -> str:
    """Return the name of a street in the results of a run."""
    return f"{survey}_{seed}"


def found_by_detector(models: Results) -> dict[str, dict[str, Any]]:
    """Join what the models of each detector found."""
    found: dict[str, dict[str, Any]] = {}
    for key, streets in models.items():
        own = found.setdefault(key.split(".")[0], {})
        own |= {street: result for street, result in streets.items() if street != "facts"}
    return found


def study_tables(
    plan: StudyPlan, streets: Results, segmented: Results, described: Results, runs: Results, variants: Results
) -> StudyTables:
    """Make the tables."""
    classes = list(plan.detection.classes)
    every = range(len(classes))
    cars = [classes.index("car")] if "car" in classes else list(every)
    counted = {
        method: {survey: _tests(plan, runs[method], survey) for survey in plan.scale.surveys} for method in DETECTORS
    }
    scores = [
        detection_table(
            {f"{survey}.{street}": found for survey, each in counted[method].items() for street, found in each.items()},
            method=method,
            classes=classes,
        )
        for method in DETECTORS
    ]
    differences = [
        yu2016.paired_differences(counted, chosen, reference=WORDS).assign(classes=name)
        for name, chosen in (("car", cars), ("all", list(every)))
    ]
    figure_12, curves = yu2016.sensitivity_table(
        {name: _tests(plan, found, next(iter(plan.scale.surveys))) for name, found in variants.items()},
        {name: found["facts"]["thresholds"] for name, found in variants.items()},
        len(classes),
    )
    three = yu2016.figures_by_survey(counted, list(every))
    paper = yu2016_paper.table_three().assign(method=WORDS)
    five = yu2016.figures_by_survey(counted, cars)
    return StudyTables(
        scores=pd.concat(scores, ignore_index=True),
        segmentation=_segmentation(plan, segmented),
        table_2=yu2016.table_two(counted[WORDS], classes),
        table_3=three.merge(paper, on=["survey", "method", "metric"], how="left"),
        table_4=_times(plan, streets, segmented, described, runs),
        table_5=_wide(five).merge(yu2016_paper.table_five(), on=["survey", "method"], how="left"),
        differences=pd.concat(differences, ignore_index=True),
        figure_12=figure_12,
        curves=curves,
    )


def _tests(plan: StudyPlan, run: Mapping[str, Any], survey: str) -> dict[str, Any]:
    """Return what a run found in the test streets of a survey."""
    return {key: run[key] for key in (run_key(survey, seed) for seed in plan.scale.surveys[survey].test)}


def _wide(figures: pd.DataFrame) -> pd.DataFrame:
    """Turn figures into a row per survey and method."""
    chosen = figures[figures["survey"] != "average"]
    counts = chosen.drop_duplicates(["survey", "method"])[["survey", "method", "tp", "fp", "fn"]]
    values = chosen.pivot(index=["survey", "method"], columns="metric", values="value")[list(yu2016.FIGURES)]
    return counts.merge(values.reset_index(), on=["survey", "method"])


def _segmentation(plan: StudyPlan, segmented: Results) -> pd.DataFrame:
    rows = []
    for key, found in segmented.items():
        method, survey, seed = key.split(".")
        if int(seed.removeprefix("seed_")) in plan.scale.surveys[survey].test:
            rows.append(
                {"survey": survey, "method": method, **{name: float(found[name]) for name in SEGMENTATION_FIGURES}}
            )
    return mean_and_spread(pd.DataFrame(rows), ["survey", "method"], SEGMENTATION_FIGURES)


def _times(plan: StudyPlan, streets: Results, segmented: Results, described: Results, runs: Results) -> pd.DataFrame:
    """Make Table IV: processor seconds of each step over the test streets, and points per second and thread."""
    rows = []
    for survey, given in plan.scale.surveys.items():
        keys = [street_key(survey, seed) for seed in given.test]
        points = sum(int(streets[key]["points"]) for key in keys)
        steps = {
            "ground removal": sum(float(streets[key]["seconds"]) for key in keys),
            "segmentation": sum(float(segmented[f"{CUT}.{key}"]["seconds"]) for key in keys),
            "quantisation": sum(float(described[f"{WORDS}.{key}"]["seconds"]) for key in keys),
            "detection": sum(float(found["seconds"]) for found in _tests(plan, runs[WORDS], survey).values()),
        }
        steps["all"] = sum(steps.values())
        rows += [(survey, step, seconds, points / max(seconds, 1e-9)) for step, seconds in steps.items()]
    table = pd.DataFrame(rows, columns=["survey", "step", "seconds", "points_per_second"])
    return table.merge(yu2016_paper.table_four(), on=["survey", "step"], how="left")
