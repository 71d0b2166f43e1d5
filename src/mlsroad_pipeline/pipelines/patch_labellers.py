"""Pipelines of methods that label patches: the training scenes, a model, and labels of the other scenes."""

# Annotations are evaluated: Kedro reads from them the class of the parameters, which differs between methods.
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd
from joblib import cpu_count
from kedro.pipeline import Node, Pipeline
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, Method
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.model_store.bundle_files import ModelFile
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.patch_graph.refined_classifier import GridParameters
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters, PatchStages
from mlsroad_pipeline.papers.shared.patches.labelling import label_patch_scene
from mlsroad_pipeline.papers.shared.patches.training import PatchTraining, join_training_scenes, number_surveys
from mlsroad_pipeline.pipelines.per_scene import MODEL, fix_arguments, named_node
from mlsroad_pipeline.pipelines.schemes import training_scheme
from mlsroad_pipeline.pipelines.training_facts import labelling
from mlsroad_pipeline.reporting.figures import objective_figure
from mlsroad_pipeline.surveys.parameters import SurveyParameters


@dataclass(frozen=True, eq=False)
class TrainingScenes:
    """Training scenes in their stores, and facts for the metadata of a model."""

    # patches, labels: patches of all scenes, and the classes of the patches of the training scenes
    patches: SceneCollection
    labels: SceneCollection
    stages: PatchStages  # Parameters of the preparation
    scheme: ClassScheme  # The classes
    trained_on: Mapping[str, Any]  # Metadata of the training data

    def load(self) -> PatchTraining:
        """Read the patches of all training scenes."""
        joined = join_training_scenes({key: self.patches[key].load() for key in self.labels}, self.labels.load_all())
        return PatchTraining(*joined, self.stages, self.scheme, self.trained_on, number_surveys(self.labels))


def gather_training(
    patches: SceneCollection,
    patch_labels: SceneCollection,
    ground: GroundParameters,
    sizes: PatchParameters,
    survey: SurveyParameters,
    classes: Mapping[str, Any],
) -> TrainingScenes:
    """Gather the training scenes; nothing is read yet."""
    trained_on = {"survey": survey.root, "splits": str(survey.splits.get("train")), "scenes": len(patch_labels)}
    scheme = training_scheme(survey, classes)
    return TrainingScenes(patches, patch_labels, PatchStages(ground, sizes), scheme, trained_on)


def gathering() -> Node:
    """Return the node that gathers the training scenes; the pipelines of all methods share it."""
    return named_node(gather_training, "patch_training", "gather_patch_training")


def train_patch_graph(
    training: TrainingScenes, parameters: PatchGraphParameters, *, slug: str
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame, Figure]:
    """Build the match graph."""
    bundle = METHODS[slug].load("train")(training.load(), slug=slug, parameters=parameters, n_threads=cpu_count())
    objective = pd.DataFrame({"objective": bundle.arrays["objective"]}).rename_axis("iteration").reset_index()
    return bundle, bundle, objective, objective_figure(bundle.arrays["objective"], title="Patch match graph")


def fit_refinement(
    training: TrainingScenes,
    parameters: GridParameters,
    graph: ModelFile,
    graph_parameters: PatchGraphParameters,
    *,
    slug: str,
) -> tuple[ModelBundle, ModelBundle]:
    """Choose the parameters of the Markov random field by cross-validation."""
    bundle = METHODS[slug].load("train")(
        training.load(),
        graph.load(),
        slug=slug,
        graph_parameters=graph_parameters,
        parameters=parameters,
        n_threads=cpu_count(),
    )
    return bundle, bundle


def _training(method: Method) -> Callable[..., tuple[ModelBundle, ModelBundle]]:
    """Return the node function that trains a method; it returns the model for workers and for the registry."""
    kind: Any = method.load("parameters")

    def train_method(training: TrainingScenes, parameters: kind) -> tuple[ModelBundle, ModelBundle]:
        """Train the method on the training scenes."""
        bundle = method.load("train")(training.load(), slug=method.slug, parameters=parameters, n_threads=cpu_count())
        return bundle, bundle

    return train_method


def _training_node(slug: str) -> Node:
    """Return the node that trains a method."""
    train: Callable[..., Any]
    inputs, outputs = {"training": "patch_training"}, list(MODEL)
    method = METHODS[slug]
    if method.refines:
        train = fix_arguments(fit_refinement, slug=slug)
        inputs |= {"graph": f"{method.refines}.model", "graph_parameters": f"params:{method.refines}"}
    elif method.load("parameters") is PatchGraphParameters:
        train = fix_arguments(train_patch_graph, slug=slug)
        outputs += [".objective", ".objective_figure"]
    else:
        train = _training(method)
    return named_node(train, outputs, f"train_{slug}", slug=slug, **inputs)


def create_pipeline(slug: str) -> Pipeline:
    """Return the pipeline of a method that labels patches."""
    label = labelling(label_patch_scene, slug, fixed={"classifier": METHODS[slug].load("use")})
    return Pipeline([gathering(), _training_node(slug), label])
