"""The study of Yu et al. 2016, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.detector import BottomUpTopDownParameters
from mlsroad_pipeline.algorithms.baselines.hough_forest.detector import HoughForestParameters
from mlsroad_pipeline.algorithms.baselines.object_matching.detector import ObjectMatchingParameters
from mlsroad_pipeline.algorithms.detection.detector import DetectionStages
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.algorithms.visual_words.training import VisualWordsParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import Deferred, SceneTask
from mlsroad_pipeline.pipelines.study import street_tasks
from mlsroad_pipeline.studies.parameters import changed
from mlsroad_pipeline.studies.yu2016 import objects as yu2016_objects
from mlsroad_pipeline.studies.yu2016 import runs as yu2016_runs
from mlsroad_pipeline.studies.yu2016 import streets as yu2016_streets
from mlsroad_pipeline.studies.yu2016.parameters import CUT, DETECTORS, SEGMENTATIONS, WORDS, StudyParameters
from mlsroad_pipeline.studies.yu2016.results import (
    StudyPlan,
    found_by_detector,
    run_key,
    street_key,
    study_tables,
)


def plan_study(
    study: StudyParameters,
    classes: Mapping[str, Any],
    ground: GroundParameters,
    segmentation: SegmentationParameters,
    detection: DetectionParameters,
    forest: HoughForestParameters,
    matching: ObjectMatchingParameters,
    descriptors: BottomUpTopDownParameters,
    words: VisualWordsParameters,
) -> StudyPlan:
    """Plan the runs."""
    scale = study.chosen_scale()
    given = zip(DETECTORS, (forest, matching, descriptors, words), strict=True)
    methods = {slug: changed(parameters, scale.methods.get(slug, {})) for slug, parameters in given}
    stages = DetectionStages(ground, replace(segmentation, method=CUT))
    return StudyPlan(scale, detection, find_scheme(classes["schemes"], detection.scheme), stages, methods)


def make_surveys(plan: StudyPlan) -> dict[str, SceneTask]:
    """Name the work that simulates each street."""
    surveys = {
        street_key(name, seed): given.street(seed)
        for name, given in plan.scale.surveys.items()
        for seed in (*given.train, *given.test)
    }
    return street_tasks(yu2016_streets.make_survey, surveys, plan.stages.ground)


def _segment(plan: StudyPlan, streets: SceneCollection, method: str, splits: Sequence[str]) -> dict[str, SceneTask]:
    points = streets.part("points")
    parameters = replace(plan.stages.segmentation, method=method)
    return {
        f"{method}.{street_key(name, seed)}": SceneTask(
            yu2016_objects.segment_street,
            {"points": points[street_key(name, seed)]},
            {"parameters": parameters, "scheme": plan.scheme, "detection": plan.detection},
        )
        for name, given in plan.scale.surveys.items()
        for split in splits
        for seed in getattr(given, split)
    }


def segment_surveys(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that segments all streets by the method that detectors build on."""
    return _segment(plan, streets, CUT, ("train", "test"))


def compare_segmentations(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that segments the test streets by the methods that it is compared with."""
    tasks: dict[str, SceneTask] = {}
    for method in SEGMENTATIONS:
        if method != CUT:
            tasks |= _segment(plan, streets, method, ("test",))
    return tasks


def _settings(plan: StudyPlan) -> dict[str, tuple[str, Any]]:
    """Return the settings of Figure 12: name to the described objects that it takes, and its parameters."""
    base = plan.methods[WORDS]
    every = {name: changed(base, changes) for name, changes in plan.scale.settings().items()}
    return {name: (WORDS if p.groups == base.groups else _safe(name), p) for name, p in every.items()}


def _described(plan: StudyPlan) -> dict[str, tuple[str, Any, list[str]]]:
    """Return what describes streets: name to method, parameters and surveys; the settings of Figure 12 take one."""
    surveys = list(plan.scale.surveys)
    found = {slug: (slug, plan.methods[slug], surveys) for slug in DETECTORS}
    own = {name: (WORDS, parameters, surveys[:1]) for name, parameters in _settings(plan).values() if name != WORDS}
    return {**found, **own}


def describe_surveys(plan: StudyPlan, streets: SceneCollection, segmented: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that describes the objects of each street as each detector and setting does."""
    points, objects = streets.part("points"), segmented.part("objects")
    tasks = {}
    for name, (method, parameters, surveys) in _described(plan).items():
        kind = yu2016_objects.DESCRIPTIONS[method]
        for survey in surveys:
            given = plan.scale.surveys[survey]
            for key in (street_key(survey, seed) for seed in (*given.train, *given.test)):
                tasks[f"{name}.{key}"] = SceneTask(
                    yu2016_objects.describe_street,
                    {"points": points[key], "objects": objects[f"{CUT}.{key}"]},
                    {"kind": kind, "parameters": getattr(parameters, kind)},
                )
    return tasks


def _runs_of_settings(plan: StudyPlan) -> dict[str, str]:
    """Return which setting is run for each: the first with the same parameters."""
    settings = _settings(plan)
    first: dict[str, str] = {}
    for name, (_, parameters) in settings.items():
        first[name] = next(other for other in settings if settings[other][1] == parameters)
    return first


def _safe(name: str) -> str:
    """Return a setting's name as a store can hold it."""
    return name.replace("=", "-").replace(".", "_")


def _run(
    plan: StudyPlan,
    name: str,
    surveys: Sequence[str],
    stores: Sequence[SceneCollection],
    method: str,
    parameters: Any,
) -> SceneTask:
    streets, segmented, described = stores
    points, parts = streets.part("points"), described.part("parts")
    objects, classes = (segmented.part(part) for part in ("objects", "classes"))

    def inputs(split: str) -> dict[str, Any]:
        given: dict[str, Any] = {}
        for survey in surveys:
            for seed in getattr(plan.scale.surveys[survey], split):
                street = street_key(survey, seed)
                own: dict[str, Any] = {"parts": parts[f"{name}.{street}"]}
                if split == "train":
                    own["classes"] = classes[f"{CUT}.{street}"]
                else:
                    own["scene"] = Deferred((points[street], objects[f"{CUT}.{street}"]))
                given[run_key(survey, seed)] = own
        return given

    return SceneTask(
        yu2016_runs.train_and_detect,
        {"train": inputs("train"), "test": inputs("test")},
        {
            "method": method, "parameters": parameters, "stages": plan.stages, "detection": plan.detection,
            "scheme": plan.scheme, "prevalence": {name: plan.scale.surveys[name].prevalence for name in surveys},
            "rare": {
                run_key(name, seed): plan.scale.surveys[name].rare_weight
                for name in surveys
                for seed in plan.scale.surveys[name].rare
            },
        },
    )  # fmt: skip


def run_detectors(plan: StudyPlan, *stores: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that trains each detector and detects in the test streets of the surveys that it learned from."""
    return {
        f"{slug}.{'_'.join(surveys)}": _run(plan, slug, surveys, stores, slug, plan.methods[slug])
        for slug in DETECTORS
        for surveys in plan.scale.learned_together()
    }


def run_settings(plan: StudyPlan, *stores: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that trains the visual words of each setting of Figure 12 on the first survey."""
    survey, own = next(iter(plan.scale.surveys)), _runs_of_settings(plan)
    return {
        _safe(name): _run(plan, described, [survey], stores, WORDS, parameters)
        for name, (described, parameters) in _settings(plan).items()
        if own[name] == name
    }


def tabulate_study(plan: StudyPlan, *stores: SceneCollection) -> tuple[Any, ...]:
    """Make the tables of the study."""
    streets, segmented, described, runs, variants, compared = stores
    found = variants.load_all()
    scores = {**compared.part("scores").load_all(), **segmented.part("scores").load_all()}
    tests = {street_key(name, seed) for name, given in plan.scale.surveys.items() for seed in given.test}
    return study_tables(
        plan,
        streets.part("facts").load_all(),
        # In the paper's order, not the store's.
        {f"{method}.{key}": scores[f"{method}.{key}"] for method in SEGMENTATIONS for key in sorted(tests)},
        described.part("facts").load_all(),
        found_by_detector(runs.load_all()),
        {name: found[_safe(run)] for name, run in _runs_of_settings(plan).items()},
    ).as_tuple()
