"""The match graph built of the training scenes."""

from __future__ import annotations

import pandas as pd
from joblib import cpu_count
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.algorithms.patch_graph.labeller import train
from mlsroad_pipeline.pipelines.patch_method import TrainingScenes
from mlsroad_pipeline.reporting.figures.training import objective_figure


def train_patch_graph(
    training: TrainingScenes, parameters: PatchGraphParameters
) -> tuple[ModelBundle, ModelBundle, pd.DataFrame, Figure]:
    """Build the match graph."""
    bundle = train(training.load(), parameters=parameters, n_threads=cpu_count())
    objective = pd.DataFrame({"objective": bundle.arrays["objective"]}).rename_axis("iteration").reset_index()
    return bundle, bundle, objective, objective_figure(bundle.arrays["objective"], title="Patch match graph")
