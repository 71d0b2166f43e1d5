"""All pipelines by name."""

from __future__ import annotations

from kedro.framework.project import find_pipelines
from kedro.pipeline import Pipeline

from mlsroad_pipeline.pipelines.methods import COMPARISON, joined

__all__ = ["COMPARISON", "register_pipelines"]


def register_pipelines() -> dict[str, Pipeline]:
    """Return the pipelines; the default is a whole comparison on the environment's survey.

    Kedro imports only the pipelines that a command names, which keeps `label` from loading the simulator.
    """
    pipelines = find_pipelines(raise_errors=True)
    if set(COMPARISON) <= set(pipelines):
        pipelines["__default__"] = joined({name: pipelines[name] for name in COMPARISON})
    return pipelines
