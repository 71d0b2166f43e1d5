"""Plan of the study of Yu et al. 2016 and its tasks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from mlsroad_pipeline.algorithms.core.classes import ClassScheme, find_scheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import Deferred, SceneTask
from mlsroad_pipeline.papers.shared.detection.detector import DetectionStages
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters
from mlsroad_pipeline.papers.shared.studies.parameters import changed, method_parameters
from mlsroad_pipeline.papers.yu2016.study import parameters as yu2016
from mlsroad_pipeline.papers.yu2016.study.runs import DESCRIPTIONS, describe_street, segment_street, train_and_detect


class Setting(NamedTuple):
    """Setting of Figure 12."""

    described: str  # name of the object descriptions that it uses
    parameters: Any  # parameters of the visual words
    run: str  # name of the first setting with the same parameters, which is the one that is run


class Description(NamedTuple):
    """Object descriptions of one detector with its parameters, for the streets of some surveys."""

    detector: str
    parameters: Any
    surveys: Sequence[str]


@dataclass(frozen=True)
class StudyPlan:
    """Parameters of all stages of the study."""

    study: yu2016.StudyParameters  # streets and settings
    detection: DetectionParameters  # classes to detect
    scheme: ClassScheme  # classes
    stages: DetectionStages  # ground filter and segmentation
    methods: Mapping[str, Any]  # detector to its parameters, changes of the scale included

    @property
    def scale(self) -> yu2016.StudyScale:
        """Return the scale that is run."""
        return self.study.chosen_scale()

    def surveys(self) -> dict[str, dict[str, Any]]:
        """Return the configuration of the simulated survey of every street."""
        return {
            yu2016.street_key(name, seed): survey.street(seed)
            for name, survey in self.scale.surveys.items()
            for seed in (*survey.train, *survey.test)
        }

    def settings(self) -> dict[str, Setting]:
        """Return the settings of Figure 12 by name."""
        base = self.methods[self.scale.varied]
        every = {name: changed(base, changes) for name, changes in self.scale.settings().items()}
        return {
            name: Setting(
                described_by(self.scale.varied) if own.groups == base.groups else yu2016.setting_key(name),
                own,
                next(other for other, parameters in every.items() if parameters == own),
            )
            for name, own in every.items()
        }

    def descriptions(self) -> dict[str, Description]:
        """Return the object descriptions of all detectors, and of the settings of Figure 12 for the first survey."""
        surveys = list(self.scale.surveys)
        names = {described_by(detector) for detector in self.scale.detectors}
        detectors = {name: Description(name, self.methods[name], surveys) for name in self.methods if name in names}
        settings = {
            setting.described: Description(self.scale.varied, setting.parameters, surveys[:1])
            for setting in self.settings().values()
            if setting.described not in detectors
        }
        return {**detectors, **settings}

    def cuts(self) -> dict[str, None]:
        """Return the segmentations whose objects are classified."""
        return dict.fromkeys(yu2016.cut_of(detector) for detector in self.scale.detectors)


def described_by(detector: str) -> str:
    """Return the name of the object descriptions of a detector."""
    return yu2016.method_of(detector)


def plan_study(
    study: yu2016.StudyParameters,
    classes: Mapping[str, Any],
    ground_removal: GroundParameters,
    segmentation: SegmentationParameters,
    detection: DetectionParameters,
    **methods: Any,
) -> StudyPlan:
    """Return the plan with the changes of the scale."""
    own = method_parameters(methods, study.chosen_scale().methods)
    own[yu2016.FLOORED] = changed(own[yu2016.PRINTED], {"vocabulary": {"floor": own[yu2016.WORDS].vocabulary.floor}})
    scheme = find_scheme(classes["schemes"], detection.scheme)
    return StudyPlan(study, detection, scheme, DetectionStages(ground_removal, segmentation), own)


def _segment(plan: StudyPlan, streets: SceneCollection, method: str, splits: Sequence[str]) -> dict[str, SceneTask]:
    points = streets.part("points")
    parameters = replace(plan.stages.segmentation, method=method)
    return {
        f"{method}.{yu2016.street_key(name, seed)}": SceneTask(
            segment_street,
            {"points": points[yu2016.street_key(name, seed)]},
            {"parameters": parameters, "scheme": plan.scheme, "detection": plan.detection},
        )
        for name, survey in plan.scale.surveys.items()
        for split in splits
        for seed in getattr(survey, split)
    }


def segment_surveys(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per street and segmentation that segments it for the detectors."""
    tasks: dict[str, SceneTask] = {}
    for cut in plan.cuts():
        tasks |= _segment(plan, streets, cut, ("train", "test"))
    return tasks


def compare_segmentations(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per other segmentation and test street."""
    tasks: dict[str, SceneTask] = {}
    for method in yu2016.SEGMENTATIONS:
        if method not in plan.cuts():
            tasks |= _segment(plan, streets, method, ("test",))
    return tasks


def describe_surveys(plan: StudyPlan, streets: SceneCollection, segmented: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per object description and street."""
    points, objects = streets.part("points"), segmented.part("objects")
    tasks = {}
    for name, description in plan.descriptions().items():
        kind, cut = DESCRIPTIONS[yu2016.method_of(description.detector)], yu2016.cut_of(description.detector)
        for survey in description.surveys:
            own = plan.scale.surveys[survey]
            for key in (yu2016.street_key(survey, seed) for seed in (*own.train, *own.test)):
                tasks[f"{name}.{key}"] = SceneTask(
                    describe_street,
                    {"points": points[key], "objects": objects[f"{cut}.{key}"]},
                    {"kind": kind, "parameters": getattr(description.parameters, kind)},
                )
    return tasks


def run_detectors(plan: StudyPlan, *stores: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per detector and model that trains it and detects in the test streets of its surveys."""
    return {
        yu2016.model_key(name, surveys): _run(plan, described_by(name), surveys, stores, name, plan.methods[name])
        for name in plan.scale.detectors
        for surveys in plan.scale.learned_together()
    }


def run_settings(plan: StudyPlan, *stores: SceneCollection) -> dict[str, SceneTask]:
    """Create one task per setting of Figure 12 that trains the visual words on the first survey."""
    survey = next(iter(plan.scale.surveys))
    return {
        yu2016.setting_key(name): _run(plan, setting.described, [survey], stores, plan.scale.varied, setting.parameters)
        for name, setting in plan.settings().items()
        if setting.run == name
    }


def _run(
    plan: StudyPlan,
    described: str,
    surveys: Sequence[str],
    stores: Sequence[SceneCollection],
    detector: str,
    parameters: Any,
) -> SceneTask:
    """Create the task of a detector; `stores` have the streets, their objects and the descriptions of these."""
    cut = yu2016.cut_of(detector)
    stages = replace(plan.stages, segmentation=replace(plan.stages.segmentation, method=cut))
    simulated, segmented, descriptions = stores
    points, parts = simulated.part("points"), descriptions.part("parts")
    objects, classes = (segmented.part(part) for part in ("objects", "classes"))
    chosen = {name: plan.scale.surveys[name] for name in surveys}

    def inputs(split: str) -> dict[str, Any]:
        streets: dict[str, Any] = {}
        for survey, configured in chosen.items():
            for seed in getattr(configured, split):
                street = yu2016.street_key(survey, seed)
                own: dict[str, Any] = {"parts": parts[f"{described}.{street}"]}
                if split == "train":
                    own["classes"] = classes[f"{cut}.{street}"]
                else:
                    own["scene"] = Deferred((points[street], objects[f"{cut}.{street}"]))
                streets[yu2016.run_key(survey, seed)] = own
        return streets

    return SceneTask(
        train_and_detect,
        {"train": inputs("train"), "test": inputs("test")},
        {
            "method": yu2016.method_of(detector), "parameters": parameters, "stages": stages,
            "detection": plan.detection, "scheme": plan.scheme,
            "prevalence": {name: survey.prevalence for name, survey in chosen.items()},
            "rare": {yu2016.run_key(name, seed): own.rare_weight for name, own in chosen.items() for seed in own.rare},
        },
    )  # fmt: skip
