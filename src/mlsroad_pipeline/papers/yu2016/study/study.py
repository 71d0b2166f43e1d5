"""Study of Yu et al. 2016: tables from the results of its tasks, and its page with the paper's results beside ours."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.shared.detection.scoring import detection_table
from mlsroad_pipeline.papers.shared.studies.streets import street_tasks
from mlsroad_pipeline.papers.shared.studies.study import Shown, Stage, Study, Tables, mean_and_spread, paper_table
from mlsroad_pipeline.papers.yu2016.study import parameters as study
from mlsroad_pipeline.papers.yu2016.study import plan as stages
from mlsroad_pipeline.papers.yu2016.study import scores as yu2016
from mlsroad_pipeline.papers.yu2016.study.runs import SegmentationScores, StreetDetections, make_survey
from mlsroad_pipeline.papers.yu2016.study.scores import CAPTIONS, study_figures

Facts = Mapping[str, Mapping[str, NDArray]]
"""Key of a street, or ``<description>.<street>``, to the facts of `make_survey` or `describe_street`."""

Segmentations = Mapping[str, SegmentationScores]
"""``<method>.<street>`` to the scores of a segmentation."""

Detections = Mapping[str, Mapping[str, StreetDetections]]
"""Detector to test street to its detections."""

SEGMENTATION_FIGURES = (
    "coverage", "weighted_coverage", "touching", "weighted_touching", "precision", "recall", "wanted", "seconds"
)  # fmt: skip


def found_by_detector(models: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, StreetDetections]]:
    """Join the detections of the models of each detector: detector to street to detections."""
    joined: dict[str, dict[str, StreetDetections]] = {}
    for key, streets in models.items():
        own = joined.setdefault(study.detector_of_model(key), {})
        own |= {street: result for street, result in streets.items() if street != "facts"}
    return joined


def study_tables(plan: stages.StudyPlan, *stores: SceneCollection) -> dict[str, pd.DataFrame]:
    """Make the tables; splits of the scores are the surveys, and table 3 has all detectors."""
    simulated, objects, descriptions, trained, tried, compared = stores
    streets, described = simulated.load_all("facts"), descriptions.load_all("facts")
    segmented = {**compared.load_all("scores"), **objects.load_all("scores")}
    models, stored = trained.load_all(), tried.load_all()
    settings = {name: stored[study.setting_key(setting.run)] for name, setting in plan.settings().items()}
    runs = found_by_detector(models)
    classes = list(plan.detection.classes)
    every = range(len(classes))
    cars = [classes.index("car")] if "car" in classes else list(every)
    counted = {
        method: {survey: _tests(plan, runs[method], survey) for survey in plan.scale.surveys}
        for method in plan.scale.detectors
    }
    words = [method for method in counted if method.startswith(study.WORDS)]
    differences = [
        yu2016.paired_differences(counted, chosen, reference=study.WORDS).assign(classes=name)
        for name, chosen in (("car", cars), ("all", list(every)))
    ]
    figure_12, curves = yu2016.sensitivity_table(
        {name: _tests(plan, run, next(iter(plan.scale.surveys))) for name, run in settings.items()},
        {name: run["facts"]["thresholds"] for name, run in settings.items()},
        len(classes),
    )
    three = yu2016.figures_by_survey(counted, list(every))
    paper = pd.concat([paper_table("yu2016", "table_3").assign(method=method) for method in words])
    five = yu2016.figures_by_survey(counted, cars)
    return {
        "setup": _setup(plan, streets),
        "training": _training(classes, models),
        "scores": _scores(counted, classes),
        "segmentation": _segmentation(plan, segmented),
        "table_2": pd.concat([yu2016.table_two(counted[method], classes).assign(method=method) for method in words]),
        "table_3": three.merge(paper, on=["survey", "method", "metric"], how="left"),
        "table_4": _times(plan, streets, segmented, described, runs),
        "table_5": _wide(five).merge(_cars_of_paper(words), on=["survey", "method"], how="left"),
        "differences": pd.concat(differences, ignore_index=True),
        "figure_12": figure_12,
        "curves": curves,
    }


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


def _setup(plan: stages.StudyPlan, streets: Facts) -> pd.DataFrame:
    """Return number of streets, points and cars left out of the reference, by survey and split."""
    rows = []
    for name, survey in plan.scale.surveys.items():
        for split in ("train", "test"):
            facts = [streets[study.street_key(name, seed)] for seed in getattr(survey, split)]
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
    table = yu2016.paper_cars()
    own = table[table["method"] == study.WORDS]
    return pd.concat([table[table["method"] != study.WORDS], *(own.assign(method=method) for method in words)])


def _tests(plan: stages.StudyPlan, run: Mapping[str, StreetDetections], survey: str) -> dict[str, StreetDetections]:
    """Return the detections of a run in the test streets of a survey."""
    return {key: run[key] for key in (study.run_key(survey, seed) for seed in plan.scale.surveys[survey].test)}


def _wide(figures: pd.DataFrame) -> pd.DataFrame:
    """Return one row per survey and method."""
    chosen = figures[figures["survey"] != "average"]
    counts = chosen.drop_duplicates(["survey", "method"])[["survey", "method", "tp", "fp", "fn"]]
    values = chosen.pivot(index=["survey", "method"], columns="metric", values="value")[list(yu2016.FIGURES)]
    return counts.merge(values.reset_index(), on=["survey", "method"])


def _segmentation(plan: stages.StudyPlan, segmented: Segmentations) -> pd.DataFrame:
    """Return the scores of the segmentations over test streets, in the order of the paper."""
    tests = sorted(
        (study.street_key(name, seed), name) for name, each in plan.scale.surveys.items() for seed in each.test
    )
    rows = []
    for method in study.SEGMENTATIONS:
        for key, survey in tests:
            figures = cast(Mapping[str, NDArray], segmented[f"{method}.{key}"])
            values = {name: float(figures[name]) for name in SEGMENTATION_FIGURES}
            rows.append({"survey": survey, "method": method, **values})
    return mean_and_spread(pd.DataFrame(rows), ["survey", "method"], SEGMENTATION_FIGURES)


def _times(
    plan: stages.StudyPlan, streets: Facts, segmented: Segmentations, described: Facts, runs: Detections
) -> pd.DataFrame:
    """Make Table IV: CPU seconds of each step over the test streets, and points per second and thread."""
    rows = []
    for survey, configured in plan.scale.surveys.items():
        keys = [study.street_key(survey, seed) for seed in configured.test]
        points = sum(int(streets[key]["points"]) for key in keys)
        steps = {
            "ground removal": sum(float(streets[key]["seconds"]) for key in keys),
            "segmentation": sum(float(segmented[f"{study.CUT}.{key}"]["seconds"]) for key in keys),
            "quantisation": sum(float(described[f"{study.WORDS}.{key}"]["seconds"]) for key in keys),
            "detection": sum(float(one["seconds"]) for one in _tests(plan, runs[study.WORDS], survey).values()),
        }
        steps["all"] = sum(steps.values())
        rows += [(survey, step, seconds, points / max(seconds, 1e-9)) for step, seconds in steps.items()]
    table = pd.DataFrame(rows, columns=["survey", "step", "seconds", "points_per_second"])
    return table.merge(yu2016.paper_speed(), on=["survey", "step"], how="left")


def study_facts(plan: stages.StudyPlan) -> dict[str, Any]:
    """Return the surveys of the runs."""
    return {
        name: f"{', '.join(f'{key} {value}' for key, value in survey.survey.items())}; "
        f"trained on {list(survey.train)}, tested on {list(survey.test)}"
        for name, survey in plan.scale.surveys.items()
    }


def study_page(plan: stages.StudyPlan, tables: Tables) -> list[Shown]:
    """Return the tables of the page."""
    spread = "Over the objects of all test streets; spread is the standard deviation between streets."
    tested = "Mean over test streets; touching: instances that touch another one."
    apart = "F-score of a method minus that of visual_words, paired by street, with 95 % intervals."
    return [
        Shown("Streets", tables["setup"], "Cars drawn over more than 8 m are left out of the reference."),
        Shown("Training", tables["training"], "Words of the vocabulary, examples, CPU seconds."),
        Shown("Segmentation", tables["segmentation"], tested),
        Shown("Table II: objects and detections", tables["table_2"], "Visual words, and the same as printed."),
        Shown("Table III: recall, precision, quality, F-score", tables["table_3"], spread),
        Shown("Table IV: time", tables["table_4"], "CPU seconds; points per second and thread."),
        Shown("Table V: cars", tables["table_5"], spread),
        Shown("Differences from the visual words", tables["differences"], apart),
        Shown("Figure 12: settings", tables["figure_12"]),
    ]


def make_surveys(plan: stages.StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    return street_tasks(make_survey, plan.surveys(), ground=plan.stages.ground)


_STORES = ["streets", "objects", "described"]

STUDY = Study(
    "yu2016",
    "Yu et al. 2016 on simulated streets",
    parameters=("classes", "ground_removal", "segmentation", "detection", *study.METHODS_OF_STUDY),
    plan=stages.plan_study,
    stages=[
        Stage("make_yu2016_streets", make_surveys, [], "streets"),
        Stage("segment_yu2016_streets", stages.segment_surveys, ["streets"], "objects"),
        Stage("describe_yu2016_objects", stages.describe_surveys, ["streets", "objects"], "described"),
        Stage("run_yu2016_detectors", stages.run_detectors, _STORES, "runs"),
        Stage("run_yu2016_settings", stages.run_settings, _STORES, "settings"),
        Stage("compare_yu2016_segmentations", stages.compare_segmentations, ["streets"], "compared"),
    ],
    results=[*_STORES, "runs", "settings", "compared"],
    tables=(
        "setup", "training", "scores", "segmentation", "table_2", "table_3", "table_4", "table_5", "differences",
        "figure_12", "curves",
    ),
    tabulate=study_tables,
    captions=CAPTIONS,
    draw=study_figures,
    facts=study_facts,
    page=study_page,
)  # fmt: skip
