"""Pipeline of the simulator."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.simulate.nodes import simulate_surveys


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to surveys below the survey root."""
    return Pipeline(
        [
            Node(
                simulate_surveys,
                inputs=["params:simulation", "params:survey"],
                outputs="simulated_surveys",
                name="simulate_surveys",
            ),
        ]
    )
