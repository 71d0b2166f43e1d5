"""The match graph built of the training scenes, and label transfer to the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from joblib import cpu_count
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.evaluation import find_scheme
from mlsroad_pipeline.algorithms.model_bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphClassifier, PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.labeller import train
from mlsroad_pipeline.algorithms.patch_labelling import PatchStages
from mlsroad_pipeline.algorithms.patches import PatchParameters
from mlsroad_pipeline.algorithms.rendering.figures import objective_figure
from mlsroad_pipeline.algorithms.scene_stages import GroundParameters
from mlsroad_pipeline.datasets.method_work import label_prepared_patches
from mlsroad_pipeline.datasets.scene_store import SceneCollection
from mlsroad_pipeline.datasets.scene_task import SceneTask, SourceFile
from mlsroad_pipeline.datasets.survey_plan import SurveyParameters

TRAIN = "train."


def train_patch_graph(
    patches: SceneCollection,
    patch_labels: SceneCollection,
    parameters: PatchGraphParameters,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame, Figure]:
    """Build the match graph.

    Parameters
    ----------
    patches, patch_labels : SceneCollection
        Patches of all scenes, and the classes of those of the training scenes.
    parameters : PatchGraphParameters
        Parameters of the graph.
    ground : GroundParameters
        How the ground was found.
    sizes : PatchParameters
        How patches were cut and described.
    survey : SurveyParameters
        Names the training files and the class scheme.
    classes : mapping
        The class schemes.

    Returns
    -------
    model, registered : ModelBundle
        The model, for the workers and for the registry.
    objective : DataFrame
        Equation 1 after every iteration.
    figure : Figure
        The same as a curve.
    """
    bundle = train(
        {key: patches[key].load() for key in patch_labels},
        patch_labels.load_all(),
        parameters=parameters,
        stages=PatchStages(ground, sizes),
        scheme=find_scheme(classes["schemes"], survey.scheme),
        trained_on={"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(patch_labels)},
        n_threads=cpu_count(),
    )
    objective = pd.DataFrame({"objective": bundle.arrays["objective"]}).rename_axis("iteration").reset_index()
    return bundle, bundle, objective, objective_figure(bundle.arrays["objective"], title="Patch match graph")


def transfer_labels(scenes: SceneCollection, patches: SceneCollection, model: SourceFile) -> dict[str, SceneTask]:
    """Name the work that labels each scene that the graph was not built of.

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
            {"classifier": PatchGraphClassifier},
        )
        for key in scenes
        if not key.startswith(TRAIN)
    }
