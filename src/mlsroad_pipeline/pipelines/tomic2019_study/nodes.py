"""The study of Tomic et al. 2019, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import Any

from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.detrended_forest.training import ForestParameters
from mlsroad_pipeline.algorithms.evaluation.labelling import find_scheme
from mlsroad_pipeline.algorithms.fusion.labeller import FusionParameters
from mlsroad_pipeline.algorithms.image_labels.training_parameters import ImageLabelsParameters
from mlsroad_pipeline.algorithms.stages import FeatureParameters, GroundParameters, SupervoxelParameters
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.pipelines.study import street_tasks
from mlsroad_pipeline.reporting.html.report import build_report
from mlsroad_pipeline.studies.tomic2019 import runs as tomic2019_runs
from mlsroad_pipeline.studies.tomic2019.figures import study_figures
from mlsroad_pipeline.studies.tomic2019.parameters import StudyParameters
from mlsroad_pipeline.studies.tomic2019.plan import PRINTED, StudyPlan, fuse_survey, make_plan, street_key
from mlsroad_pipeline.studies.tomic2019.report import study_sections
from mlsroad_pipeline.studies.tomic2019.results import StudyTables, study_tables
from mlsroad_pipeline.surveys.simulated import simulation_parameters

NETWORK = "network"


def plan_study(
    study: StudyParameters,
    classes: Mapping[str, Any],
    ground: GroundParameters,
    supervoxels: SupervoxelParameters,
    features: FeatureParameters,
    forest: ForestParameters,
    images: ImageLabelsParameters,
    fusion: FusionParameters,
) -> StudyPlan:
    """Plan the runs."""
    scheme = find_scheme(classes["schemes"], "tomic2019")
    length = simulation_parameters(study.chosen_scale().survey).length
    return make_plan(study, scheme, ground, supervoxels, features, forest, images, fusion.pool, length=length)


def make_surveys(plan: StudyPlan) -> dict[str, SceneTask]:
    """Name the work that simulates the surveys that are divided."""
    scale = plan.study.chosen_scale()
    surveys = {street_key(seed): {**scale.survey, "seed": seed} for seed in scale.seeds}
    return street_tasks(tomic2019_runs.make_survey, surveys, plan.ground)


def make_photographs(plan: StudyPlan) -> dict[str, SceneTask]:
    """Name the work that simulates the images that the network learns from."""
    scale = plan.study.chosen_scale()
    kinds = cycle(scale.photographs)
    surveys = {
        street_key(seed): {**kind, "seed": seed} for seed, kind in zip(scale.photograph_seeds, kinds, strict=False)
    }
    return street_tasks(tomic2019_runs.make_photographs, surveys, plan.ground)


def train_network(plan: StudyPlan, photographs: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that trains the network."""
    images = photographs.part("images")
    return {
        NETWORK: SceneTask(
            tomic2019_runs.train_network,
            {"photographs": {key: images[key] for key in images}},
            {"parameters": plan.images, "scheme": plan.scheme},
        )
    }


def label_by_features(plan: StudyPlan, streets: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that trains each forest on half of a survey and labels the other half of one."""
    points = streets.part("points")
    return {
        f"{name}.{street}": SceneTask(
            tomic2019_runs.train_and_label,
            {"points": points[street], "training": points[plan.training_street(street)]},
            {"variant": variant, "division": plan.division, "scheme": plan.scheme},
        )
        for name, variant in plan.forests.items()
        for street in plan.streets
    }


def label_by_images(plan: StudyPlan, streets: SceneCollection, networks: SceneCollection) -> dict[str, SceneTask]:
    """Name the work that labels half of each survey through its images."""
    points, images = streets.part("points"), streets.part("images")
    weights = networks.part("weights")[NETWORK]
    return {
        street: SceneTask(
            tomic2019_runs.label_by_images,
            {"points": points[street], "images": images[street], "network": weights},
            {"parameters": plan.images, "division": plan.division, "scheme": plan.scheme},
        )
        for street in plan.streets
    }


def fuse_surveys(
    plan: StudyPlan, streets: SceneCollection, features: SceneCollection, images: SceneCollection
) -> dict[str, SceneTask]:
    """Name the work that fuses the labels of each forest and survey with those of the images."""
    points, first, second = streets.part("points"), features.part("labels"), images.part("labels")
    return {
        f"{name}.{street}": SceneTask(
            fuse_survey,
            {"points": points[street], "features": first[f"{name}.{street}"], "images": second[street]},
            {"division": plan.division, "scheme": plan.scheme, "pool": plan.pool},
        )
        for name in plan.forests
        for street in plan.streets
    }


def tabulate_study(
    plan: StudyPlan, features: SceneCollection, images: SceneCollection, runs: SceneCollection
) -> tuple[Any, ...]:
    """Make the tables of the study."""
    return study_tables(
        plan,
        runs.part("results").load_all(),
        images.part("pixels").load_all(),
        features.part("facts").load_all(),
    ).as_tuple()


def draw_study(plan: StudyPlan, *given: Any) -> tuple[Figure | str, ...]:
    """Draw the figures of the study, the paper's of its first survey, and write its report."""
    streets, features, images, runs = given[:4]
    tables, street = StudyTables(*given[4:]), plan.streets[0]
    key = f"{PRINTED}.{street}"
    figures = study_figures(
        plan,
        tables,
        points=streets.part("points")[street].load(),
        images=streets.part("images")[street].load(),
        features=features.part("labels")[key].load(),
        through_images=images.part("labels")[street].load(),
        pixels=images.part("pixels")[street].load(),
        answers=runs.part("answers")[key].load(),
    )
    page = build_report(study_sections(plan, tables, figures), title="Tomic et al. 2019 on simulated surveys")
    return *figures, page
