"""Registry entry of a model that was trained for the package: its parameters, training data and scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pandas as pd

from mlsroad_pipeline import __version__
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.fusion.pool import NETWORK, TREES, pool_bundle
from mlsroad_pipeline.algorithms.fusion.pool import SLUG as POOL
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.datasets.models.shipped_models import ModelScores, ShippedModel

LICENCE = "MIT"


@dataclass(frozen=True)
class ShippedParameters:
    """A model to train for the package.

    Parameters
    ----------
    name : str, default ""
        Name of the model, and of the environment that trains it.
    summary : str, default ""
        Surveys that the model is for, in one line.
    root : str, default ""
        Folder of the recordings.
    recordings : mapping of str to mapping
        Recordings to train on beside the simulated streets: name to the fields of `TrainingRecording`.
    recorded_scheme : str, default "common"
        Class scheme that the labels of the recordings separate; it may be coarser than that of the model.
    weight : float, default 3.0
        Weight of all simulated streets together; that of a recording is 1.
    recorded_per_class : int, default 3000
        Maximum training samples per class and scene of a recording.
    network_weight : float, default 0.5
        Weight of the network in the pool with the trees, 0 to 1. Larger follows the network more, which did not learn
        from recordings.
    """

    name: str = ""
    summary: str = ""
    root: str = ""
    recordings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    recorded_scheme: str = "common"
    weight: float = 3.0
    recorded_per_class: int = 3000
    network_weight: float = 0.5

    def command(self) -> str:
        """Return the command that trains the model.

        Returns
        -------
        str
            The command.

        Raises
        ------
        ParameterError
            If the model has no name.
        """
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
    """Return the registry entry of a trained model, without its files.

    Parameters
    ----------
    bundle : ModelBundle
        The model.
    parameters : ShippedParameters
        Name and summary.
    training : mapping of str to mapping
        See `ShippedModel`.
    scores : tuple of ModelScores
        See `ShippedModel`.
    recordings : mapping of str to mapping, optional
        See `ShippedModel`.

    Returns
    -------
    ShippedModel
        The entry.
    """
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
    """Return the pool of trees and network, and its registry entry.

    Parameters
    ----------
    trees : ModelBundle
        The trees.
    entry : ShippedModel
        Their entry, which names the training data of both.
    network : ModelBundle
        The superpoint transformer, trained on the same simulated streets.
    parameters : ShippedParameters
        Weight of the network.

    Returns
    -------
    bundle : ModelBundle
        The pool.
    entry : ShippedModel
        Its entry, without files and scores.
    """
    share = parameters.network_weight
    bundle = pool_bundle({TREES: trees, NETWORK: network}, {TREES: 1.0 - share, NETWORK: share})
    own = replace(entry, name=POOL, method=POOL, summary=f"{entry.summary}; slower and better", files={}, scores=())
    return bundle, own


def split_scores(table: pd.DataFrame, command: str) -> tuple[ModelScores, ...]:
    """Return the scores of each split from a table of scores.

    Parameters
    ----------
    table : DataFrame
        Columns split, class, metric, value and support, see `ScoresDataset`.
    command : str
        Command that prints them.

    Returns
    -------
    tuple of ModelScores
        One per split.
    """
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
