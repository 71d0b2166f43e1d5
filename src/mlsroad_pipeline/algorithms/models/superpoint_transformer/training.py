"""Training of a superpoint transformer on labelled graphs. Importing this module imports torch."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.stage_parameters import StageParameters
from mlsroad_pipeline.algorithms.models.bundle import Checkpoints, ModelBundle
from mlsroad_pipeline.algorithms.models.superpoint_transformer.building import point_feature_names
from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph
from mlsroad_pipeline.algorithms.models.superpoint_transformer.optimisation import train_network
from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (
    SLUG,
    SuperpointTransformerParameters,
)


def fit(
    graphs: Sequence[Mapping[str, NDArray]],
    *,
    parameters: SuperpointTransformerParameters,
    stages: StageParameters,
    scheme: ClassScheme,
    trained_on: Mapping[str, Any],
    checkpoints: Checkpoints | None = None,
) -> tuple[ModelBundle, list[float]]:
    """Train a network."""
    if not graphs:
        raise DataError("no training scenes: the split 'train' is empty")
    names = graphs[0]["names"].tolist()
    for graph in graphs:
        if graph["names"].tolist() != names:
            raise DataError(
                f"training scenes have different features: {', '.join({*names} ^ {*graph['names'].tolist()})}"
            )
    trained = train_network(
        [SuperpointGraph.from_arrays(graph) for graph in graphs],
        n_classes=len(scheme),
        parameters=parameters,
        checkpoints=checkpoints,
    )
    weights = {f"weights.{name}": value.numpy() for name, value in trained.network.state_dict().items()}
    attributes = [name for name in ("rgb", "intensity") if any(name in graph["attributes"] for graph in graphs)]
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "parameters": {"superpoint_transformer": asdict(parameters), **asdict(stages)},
        "feature_names": {"points": point_feature_names(parameters.hierarchy), "superpoints": names},
        "attributes": attributes,
        "trained_on": {**trained_on, "graphs": len(graphs)},
        "n_weights": int(sum(value.size for value in weights.values())),
    }
    arrays = {**weights, **trained.scale.to_arrays(), "class_weights": trained.class_weights}
    return ModelBundle(SLUG, arrays, metadata), trained.losses
