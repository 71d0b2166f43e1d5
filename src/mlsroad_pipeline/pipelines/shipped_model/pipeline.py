"""Pipeline of the shipped models: simulated streets to a trained and scored model in the package."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines import composition
from mlsroad_pipeline.pipelines.shipped_model.nodes import ship_model

_PARTS = ("simulate", "ingest", "ground_removal", "supervoxelise", "features", "detrended_forest", "evaluation")


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: the comparison with the forest alone, then the model as files of the package."""
    parts = composition.joined({name: composition.create_pipeline(name) for name in _PARTS})
    ship = Node(
        ship_model,
        inputs=["detrended_forest.model", "detrended_forest.scores", "params:shipped", "params:simulation"],
        outputs="shipped_model",
        name="ship_model",
    )
    return Pipeline([parts.to_outputs("detrended_forest.scores"), ship])
