"""Which pipeline `kedro run` runs where none is named: an environment may say so."""

from __future__ import annotations

from kedro.framework.context import KedroContext
from kedro.framework.hooks import hook_impl
from kedro.framework.project import pipelines

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.pipelines.composition import comparison, joined

KEY = "default_pipeline"
"""The parameter that names it."""


class DefaultPipelineHooks:
    """Put the pipeline that an environment's parameter `default_pipeline` names in the place of the default."""

    def __init__(self) -> None:
        self._changed = False

    @hook_impl(trylast=True)
    def after_context_created(self, context: KedroContext) -> None:
        """Exchange the default; another environment of the same process gets the comparison back."""
        if "__default__" not in pipelines:  # a pipeline was named
            return
        name = context.config_loader["parameters"].get(KEY)
        if name is None and not self._changed:
            return
        if name is not None and name not in pipelines:
            raise ParameterError(f"{KEY} is {name!r}, which is no pipeline ({', '.join(sorted(pipelines))})")
        pipelines["__default__"] = (
            joined({part: pipelines[part] for part in comparison()}) if name is None else pipelines[name]
        )
        self._changed = name is not None
