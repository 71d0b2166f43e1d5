"""The Markov random field fitted to the training scenes."""

from __future__ import annotations

from joblib import cpu_count

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.labeller import train_refinement
from mlsroad_pipeline.algorithms.patch_graph.refined_classifier import GridParameters
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model
from mlsroad_pipeline.execution.task import SourceFile
from mlsroad_pipeline.pipelines.patch_method import TrainingScenes


def fit_refinement(
    training: TrainingScenes, parameters: GridParameters, graph: SourceFile, graph_parameters: PatchGraphParameters
) -> tuple[ModelBundle, ModelBundle]:
    """Choose the parameters of the field by cross-validation."""
    bundle = train_refinement(
        training.load(),
        open_model(graph.load()),
        graph_parameters=graph_parameters,
        parameters=parameters,
        n_threads=cpu_count(),
    )
    return bundle, bundle
