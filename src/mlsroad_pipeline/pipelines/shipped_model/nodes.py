"""Node of the shipped models: compact files and a registry entry."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mlsroad_pipeline.algorithms.detrended_forest.compaction import compact_bundle
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.datasets.models.bundle_files import ModelFile
from mlsroad_pipeline.datasets.models.shipped_entry import ShippedParameters, describe_model, split_scores
from mlsroad_pipeline.datasets.models.shipped_models import ShippedModel
from mlsroad_pipeline.surveys.simulated import selected_surveys


def ship_model(
    model: ModelFile, scores: pd.DataFrame, shipped: ShippedParameters, simulation: Mapping[str, Any]
) -> tuple[ModelBundle, ShippedModel]:
    """Return the model in its compact form, and its registry entry."""
    bundle = compact_bundle(model.load())
    training = {name: dict(street) for name, street in selected_surveys(simulation).items() if name.startswith("train")}
    entry = describe_model(bundle, shipped, training=training, scores=split_scores(scores, shipped.command()))
    return bundle, entry
