"""Registry entry of a model that was trained for the package: its parameters, training data and scores."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pandas as pd

from mlsroad_pipeline import __version__
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.familiarity import familiarity_of
from mlsroad_pipeline.algorithms.models.pool.labeller import NETWORK, TREES, pool_bundle
from mlsroad_pipeline.algorithms.models.pool.labeller import SLUG as POOL
from mlsroad_pipeline.model_store.shipped_models import ModelScores, ShippedModel

LICENCE = "MIT"


@dataclass(frozen=True)
class ShippedParameters:
    """A model to train for the package."""

    name: str = ""  # Name of the model, and of the environment that trains it
    summary: str = ""  # Surveys that the model is for, in one line
    root: str = ""  # Folder of the recordings
    # Recordings to train on beside the simulated streets: name to the fields of `TrainingRecording`
    recordings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # Class scheme that the labels of the recordings separate; it may be coarser than that of the model
    recorded_scheme: str = "common"
    weight: float = 3.0  # Weight of all simulated streets together; that of a recording is 1
    recorded_per_class: int = 3000  # Maximum training samples per class and scene of a recording
    # Weight of the network in the pool with the trees, 0 to 1. Larger follows the network more.
    network_weight: float = 0.5
    # Streets that train the object classifier, as in `simulation.surveys`
    classifier_streets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    colour_streets: int = 48  # Number of streets that train the colour of the ground
    # Parameters of the simulator that replace those of the streets for the colour of the ground
    colour_survey: Mapping[str, Any] = field(default_factory=dict)

    def command(self) -> str:
        """Return the command that trains the model."""
        if not self.name:
            raise ParameterError("shipped.name is not set: kedro run --env=general trains the models of the package")
        return f"kedro run --env={self.name}"


def describe_model(
    bundle: ModelBundle,
    parameters: ShippedParameters,
    *,
    training: Mapping[str, Mapping[str, Any]],
    scores: tuple[ModelScores, ...],
    recordings: Mapping[str, Mapping[str, Any]] | None = None,
) -> ShippedModel:
    """Return the registry entry of a trained model, without its files."""
    metadata = bundle.metadata
    return ShippedModel(
        name=parameters.name,
        method=bundle.slug,
        summary=parameters.summary,
        version=__version__,
        licence=LICENCE,
        command=parameters.command(),
        files={},
        classes=bundle.classes,
        attributes=tuple(metadata["attributes"]),
        training=training,
        samples=int(metadata["trained_on"]["voxels"]),
        scores=scores,
        recordings=recordings or {},
        training_facts=metadata.get("training_facts", {}),
    )


def shipped_pool(
    trees: ModelBundle, entry: ShippedModel, network: ModelBundle, parameters: ShippedParameters
) -> tuple[ModelBundle, ShippedModel]:
    """Return the pool of trees and network, and its registry entry."""
    share = parameters.network_weight
    pool = pool_bundle({TREES: trees, NETWORK: network}, {TREES: 1.0 - share, NETWORK: share})
    own = replace(entry, name=POOL, method=POOL, summary=f"{entry.summary}; slower and better", files={}, scores=())
    return familiarity_of(trees, pool), own


def split_scores(table: pd.DataFrame, command: str) -> tuple[ModelScores, ...]:
    """Return the scores of each split from a table of scores."""
    found = []
    for split, rows in table.groupby("split", sort=False):
        overall = rows[rows["class"] == "all"].set_index("metric")["value"].to_dict()
        points = rows.loc[rows["metric"] == "overall_accuracy", "support"].iloc[0]
        f1 = rows[(rows["class"] != "all") & (rows["metric"] == "f1")].set_index("class")["value"].to_dict()
        found.append(
            ModelScores(
                f"simulated street {split}",
                int(points),
                round(float(overall["overall_accuracy"]), 4),
                round(float(overall["mean_f1"]), 4),
                {str(name): None if pd.isna(value) else round(float(value), 4) for name, value in f1.items()},
                command,
            )
        )
    return tuple(found)
