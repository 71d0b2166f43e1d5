"""Pipeline of the simulated sets of objects."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.simulated_objects.nodes import cut_streets, draw_splits, tabulate_sets


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: parameters to ``simulated_objects.streets``, ``.sets`` and ``.composition``."""
    own, classes = "params:simulated_objects", "params:classes"
    streets, sets, composition = (f"simulated_objects.{name}" for name in ("streets", "sets", "composition"))
    stages = ["params:ground_removal", "params:segmentation"]
    return Pipeline(
        [
            Node(cut_streets, inputs=[own, *stages, classes], outputs=streets, name="cut_simulated_streets"),
            Node(draw_splits, inputs=[own, streets, classes], outputs=sets, name="draw_simulated_sets"),
            Node(tabulate_sets, inputs=[own, sets, classes], outputs=composition, name="tabulate_simulated_sets"),
        ]
    )
