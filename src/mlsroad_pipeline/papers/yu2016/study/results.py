"""Tables of the study of Yu et al. 2016, made from the results of its tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.papers.shared.detection.scoring import detection_table
from mlsroad_pipeline.papers.shared.studies.tables import Tables, mean_and_spread
from mlsroad_pipeline.papers.yu2016.study import paper as yu2016_paper
from mlsroad_pipeline.papers.yu2016.study import scores as yu2016
from mlsroad_pipeline.papers.yu2016.study.keys import detector_of_model, run_key, setting_key, street_key
from mlsroad_pipeline.papers.yu2016.study.objects import DescriptionFacts, SegmentationScores
from mlsroad_pipeline.papers.yu2016.study.parameters import CUT, SEGMENTATIONS, WORDS
from mlsroad_pipeline.papers.yu2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.yu2016.study.runs import StreetDetections
from mlsroad_pipeline.papers.yu2016.study.streets import StreetFacts

Streets = Mapping[str, StreetFacts]
"""Key of a street to its facts."""

Segmentations = Mapping[str, SegmentationScores]
"""``<method>.<street>`` to the scores of a segmentation."""

Descriptions = Mapping[str, DescriptionFacts]
"""``<description>.<street>`` to facts of the description."""

Detections = Mapping[str, Mapping[str, StreetDetections]]
"""Detector to test street to its detections."""

SEGMENTATION_FIGURES = (
    "coverage", "weighted_coverage", "touching", "weighted_touching", "precision", "recall", "wanted", "seconds"
)  # fmt: skip


@dataclass(frozen=True)
class StudyTables(Tables):
    """Tables of the study."""

    setup: pd.DataFrame  # streets, points and cars left out of the reference, by survey and split
    training: pd.DataFrame  # words, examples of each class and CPU time of each model
    scores: pd.DataFrame  # table of scores; its splits are the surveys
    segmentation: pd.DataFrame  # scores of each segmentation and survey: mean and spread over the test streets
    # table_2, table_3, table_4, table_5: the paper's tables with its values next to ours; table 3 has all detectors
    table_2: pd.DataFrame
    table_3: pd.DataFrame
    table_4: pd.DataFrame
    table_5: pd.DataFrame
    # F-score of the other detectors minus that of the visual words, paired by street, for cars and for all classes
    differences: pd.DataFrame
    # figure_12, curves: settings of the visual words, and their precision-recall curves
    figure_12: pd.DataFrame
    curves: pd.DataFrame


def found_by_detector(models: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, StreetDetections]]:
    """Join the detections of the models of each detector: detector to street to detections."""
    joined: dict[str, dict[str, StreetDetections]] = {}
    for key, streets in models.items():
        own = joined.setdefault(detector_of_model(key), {})
        own |= {street: result for street, result in streets.items() if street != "facts"}
    return joined


def runs_of_settings(plan: StudyPlan, runs: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Return the run of each setting of Figure 12."""
    return {name: runs[setting_key(setting.run)] for name, setting in plan.settings().items()}


def study_tables(
    plan: StudyPlan,
    streets: Streets,
    segmented: Segmentations,
    described: Descriptions,
    models: Mapping[str, Mapping[str, Any]],
    settings: Mapping[str, Mapping[str, Any]],
) -> StudyTables:
    """Make the tables; the runs of models and settings have the facts of their model besides their streets."""
    runs = found_by_detector(models)
    classes = list(plan.detection.classes)
    every = range(len(classes))
    cars = [classes.index("car")] if "car" in classes else list(every)
    counted = {
        method: {survey: _tests(plan, runs[method], survey) for survey in plan.scale.surveys}
        for method in plan.scale.detectors
    }
    words = [method for method in counted if method.startswith(WORDS)]
    differences = [
        yu2016.paired_differences(counted, chosen, reference=WORDS).assign(classes=name)
        for name, chosen in (("car", cars), ("all", list(every)))
    ]
    figure_12, curves = yu2016.sensitivity_table(
        {name: _tests(plan, run, next(iter(plan.scale.surveys))) for name, run in settings.items()},
        {name: run["facts"]["thresholds"] for name, run in settings.items()},
        len(classes),
    )
    three = yu2016.figures_by_survey(counted, list(every))
    paper = pd.concat([yu2016_paper.table_three().assign(method=method) for method in words])
    five = yu2016.figures_by_survey(counted, cars)
    return StudyTables(
        setup=_setup(plan, streets),
        training=_training(classes, models),
        scores=_scores(counted, classes),
        segmentation=_segmentation(plan, segmented),
        table_2=pd.concat([yu2016.table_two(counted[method], classes).assign(method=method) for method in words]),
        table_3=three.merge(paper, on=["survey", "method", "metric"], how="left"),
        table_4=_times(plan, streets, segmented, described, runs),
        table_5=_wide(five).merge(_cars_of_paper(words), on=["survey", "method"], how="left"),
        differences=pd.concat(differences, ignore_index=True),
        figure_12=figure_12,
        curves=curves,
    )


def _scores(counted: Mapping[str, Mapping[str, Mapping[str, Any]]], classes: Sequence[str]) -> pd.DataFrame:
    """Return the scores of each detector over all streets of all surveys."""
    tables = [
        detection_table(
            {
                f"{survey}.{street}": cast(Mapping[str, NDArray], one)
                for survey, each in surveys.items()
                for street, one in each.items()
            },
            method=method,
            classes=classes,
        )
        for method, surveys in counted.items()
    ]
    return pd.concat(tables, ignore_index=True)


def _setup(plan: StudyPlan, streets: Streets) -> pd.DataFrame:
    """Return number of streets, points and cars left out of the reference, by survey and split."""
    rows = []
    for name, survey in plan.scale.surveys.items():
        for split in ("train", "test"):
            facts = [streets[street_key(name, seed)] for seed in getattr(survey, split)]
            points, left_out = (sum(int(each[key]) for each in facts) for key in ("points", "streaks"))
            rows.append((name, split, len(facts), points, left_out))
    return pd.DataFrame(rows, columns=["survey", "split", "streets", "points", "cars_left_out"])


def _training(classes: Sequence[str], models: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Return words, examples of each class and CPU time of each model."""
    rows = [
        (key, int(run["facts"]["words"]), *run["facts"]["examples"].tolist(), float(run["facts"]["train_seconds"]))
        for key, run in models.items()
    ]
    return pd.DataFrame(rows, columns=["model", "words", *classes, "seconds"])


def _cars_of_paper(words: Sequence[str]) -> pd.DataFrame:
    """Return the paper's Table V, with the rows of the visual words for each of their variants."""
    table = yu2016_paper.table_five()
    own = table[table["method"] == WORDS]
    return pd.concat([table[table["method"] != WORDS], *(own.assign(method=method) for method in words)])


def _tests(plan: StudyPlan, run: Mapping[str, StreetDetections], survey: str) -> dict[str, StreetDetections]:
    """Return the detections of a run in the test streets of a survey."""
    return {key: run[key] for key in (run_key(survey, seed) for seed in plan.scale.surveys[survey].test)}


def _wide(figures: pd.DataFrame) -> pd.DataFrame:
    """Return one row per survey and method."""
    chosen = figures[figures["survey"] != "average"]
    counts = chosen.drop_duplicates(["survey", "method"])[["survey", "method", "tp", "fp", "fn"]]
    values = chosen.pivot(index=["survey", "method"], columns="metric", values="value")[list(yu2016.FIGURES)]
    return counts.merge(values.reset_index(), on=["survey", "method"])


def _segmentation(plan: StudyPlan, segmented: Segmentations) -> pd.DataFrame:
    """Return the scores of the segmentations over test streets, in the order of the paper."""
    tests = sorted((street_key(name, seed), name) for name, each in plan.scale.surveys.items() for seed in each.test)
    rows = []
    for method in SEGMENTATIONS:
        for key, survey in tests:
            figures = cast(Mapping[str, NDArray], segmented[f"{method}.{key}"])
            values = {name: float(figures[name]) for name in SEGMENTATION_FIGURES}
            rows.append({"survey": survey, "method": method, **values})
    return mean_and_spread(pd.DataFrame(rows), ["survey", "method"], SEGMENTATION_FIGURES)


def _times(
    plan: StudyPlan, streets: Streets, segmented: Segmentations, described: Descriptions, runs: Detections
) -> pd.DataFrame:
    """Make Table IV: CPU seconds of each step over the test streets, and points per second and thread."""
    rows = []
    for survey, configured in plan.scale.surveys.items():
        keys = [street_key(survey, seed) for seed in configured.test]
        points = sum(int(streets[key]["points"]) for key in keys)
        steps = {
            "ground removal": sum(float(streets[key]["seconds"]) for key in keys),
            "segmentation": sum(float(segmented[f"{CUT}.{key}"]["seconds"]) for key in keys),
            "quantisation": sum(float(described[f"{WORDS}.{key}"]["seconds"]) for key in keys),
            "detection": sum(float(one["seconds"]) for one in _tests(plan, runs[WORDS], survey).values()),
        }
        steps["all"] = sum(steps.values())
        rows += [(survey, step, seconds, points / max(seconds, 1e-9)) for step, seconds in steps.items()]
    table = pd.DataFrame(rows, columns=["survey", "step", "seconds", "points_per_second"])
    return table.merge(yu2016_paper.table_four(), on=["survey", "step"], how="left")
