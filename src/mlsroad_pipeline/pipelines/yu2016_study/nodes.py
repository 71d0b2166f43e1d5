"""Nodes of the study of Yu et al. 2016; the other stages are in `studies.yu2016.plan`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.baselines.bottom_up_top_down.detector import BottomUpTopDownParameters
from mlsroad_pipeline.algorithms.baselines.hough_forest.detector import HoughForestParameters
from mlsroad_pipeline.algorithms.baselines.object_matching.detector import ObjectMatchingParameters
from mlsroad_pipeline.algorithms.detection.scoring import DetectionParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.algorithms.stages import GroundParameters
from mlsroad_pipeline.algorithms.visual_words.training import VisualWordsParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.pipelines.study import street_tasks
from mlsroad_pipeline.studies.yu2016 import plan as yu2016_plan
from mlsroad_pipeline.studies.yu2016 import results as yu2016_results
from mlsroad_pipeline.studies.yu2016.parameters import DETECTORS, StudyParameters
from mlsroad_pipeline.studies.yu2016.plan import StudyPlan
from mlsroad_pipeline.studies.yu2016.results import StudyTables, study_tables
from mlsroad_pipeline.studies.yu2016.streets import make_survey


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
    scheme = find_scheme(classes["schemes"], detection.scheme)
    methods = dict(zip(DETECTORS, (forest, matching, descriptors, words), strict=True))
    return yu2016_plan.plan_study(
        study, scheme=scheme, ground=ground, segmentation=segmentation, detection=detection, methods=methods
    )


def make_surveys(plan: StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    return street_tasks(make_survey, plan.surveys(), ground=plan.stages.ground)


def tabulate_study(plan: StudyPlan, *stores: SceneCollection) -> StudyTables:
    """Make the tables."""
    streets, segmented, described, runs, settings, compared = stores
    return study_tables(
        plan,
        streets.load_all("facts"),
        yu2016_results.segmentations_of_tests(plan, {**compared.load_all("scores"), **segmented.load_all("scores")}),
        described.load_all("facts"),
        yu2016_results.found_by_detector(runs.load_all()),
        yu2016_results.runs_of_settings(plan, settings.load_all()),
    )
