"""The Markov random field fitted to the training scenes, and refined labels of the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.labeller import train_refinement
from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import GridParameters, RefinedPatchGraphClassifier
from mlsroad_pipeline.algorithms.patch_labelling import PatchStages
from mlsroad_pipeline.algorithms.patches import PatchParameters
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.datasets.method_work import label_prepared_patches
from mlsroad_pipeline.datasets.model_bundle_dataset import open_model
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask, SourceFile
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

TRAIN = "train."


def fit_refinement(
    patches: SceneCollection,
    patch_labels: SceneCollection,
    graph: SourceFile,
    parameters: GridParameters,
    graph_parameters: PatchGraphParameters,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle]:
    """Choose the parameters of the field by cross-validation.

    Parameters
    ----------
    patches, patch_labels : SceneCollection
        Patches of all scenes, and the classes of those of the training scenes.
    graph : SourceFile
        The model of label transfer.
    parameters : GridParameters
        What to choose from.
    graph_parameters : PatchGraphParameters
        Parameters of the graph.
    ground : GroundParameters
        How the ground was found.
    sizes : PatchParameters
        How patches were cut and described.
    survey : SurveyParameters
        Names the class scheme.
    classes : mapping
        The class schemes.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    """
    bundle = train_refinement(
        {key: patches[key].load() for key in patch_labels},
        patch_labels.load_all(),
        open_model(graph.load()),
        graph_parameters=graph_parameters,
        grid=parameters,
        stages=PatchStages(ground, sizes),
        scheme=find_scheme(classes["schemes"], survey.scheme),
    )
    return bundle, bundle


def refine_labels(scenes: SceneCollection, patches: SceneCollection, model: SourceFile) -> dict[str, SceneTask]:
    """Name the work that labels each scene that the model was not trained on.

    Parameters
    ----------
    scenes, patches : SceneCollection
        The scenes and their patches.
    model : SourceFile
        The model's folder.

    Returns
    -------
    dict of str to SceneTask
        One task per scene of the other splits.
    """
    return {
        key: SceneTask(
            label_prepared_patches,
            {"scene": scenes[key], "patches": patches[key], "model": model},
            {"classifier": RefinedPatchGraphClassifier},
        )
        for key in scenes
        if not key.startswith(TRAIN)
    }
