"""Pipeline of the comparison over several test streets."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.papers.comparison.streets.tables import TASKS
from mlsroad_pipeline.pipelines.comparison_report.nodes import DETECTORS, METHODS, PICTURED, compare_over_streets


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline: stored results of `kedro run --env=compare` to one page."""
    parts = [f"{slug}.scores" for methods in METHODS for slug in methods]
    parts += [f"{slug}.birds_eye_figure" for slug in PICTURED]
    parts += [f"{slug}.precision_recall_figure" for slug in DETECTORS]
    tables = [f"{task.name}_{table}" for task in TASKS for table in ("overview", "classes", "differences")]
    outputs = [*(f"{task.name}_scores" for task in TASKS), *tables, "costs", "report"]
    return Pipeline(
        [
            Node(
                compare_over_streets,
                inputs=["stage_costs", "params:survey", *parts],
                outputs=[f"all_methods.{name}" for name in outputs],
                name="compare_over_streets",
            )
        ]
    )
