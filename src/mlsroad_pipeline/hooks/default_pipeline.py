"""Default pipeline of an environment, run by `kedro run` without a pipeline name."""

from kedro.framework.context import KedroContext
from kedro.framework.hooks import hook_impl
from kedro.framework.project import pipelines

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.pipelines.composition import comparison, create_pipeline, joined

KEY = "default_pipeline"
"""Parameter with the name of the default pipeline."""


class DefaultPipelineHooks:
    """Replace the default pipeline by the one in the parameter `default_pipeline` of the environment."""

    def __init__(self) -> None:
        self._changed = False

    @hook_impl(trylast=True)
    def after_context_created(self, context: KedroContext) -> None:
        """Replace the default pipeline; restore the comparison for another environment in the same process."""
        if "__default__" not in pipelines:  # the command names a pipeline
            return
        name = context.config_loader["parameters"].get(KEY)
        if name is None and not self._changed:
            return
        if name is not None and name not in pipelines:
            raise ParameterError(f"unknown {KEY} {name!r} (known: {', '.join(sorted(pipelines))})")
        pipelines["__default__"] = (
            joined({part: create_pipeline(part) for part in comparison()}) if name is None else pipelines[name]
        )
        self._changed = name is not None
