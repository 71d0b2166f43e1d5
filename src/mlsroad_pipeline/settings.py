"""Project settings: the configuration loader and the hooks."""

from mlsroad_pipeline.hooks.early_workers import EarlyWorkersHooks

early_workers = EarlyWorkersHooks()  # `label` gains 1.3 s by a start before the imports below; see the module

from omegaconf.resolvers import oc  # noqa: E402

from mlsroad_pipeline.config import ParameterConfigLoader  # noqa: E402
from mlsroad_pipeline.hooks.closing_lines import ClosingLinesHooks  # noqa: E402
from mlsroad_pipeline.hooks.default_pipeline import DefaultPipelineHooks  # noqa: E402
from mlsroad_pipeline.hooks.label_run import LabelRunHooks  # noqa: E402
from mlsroad_pipeline.hooks.library_warnings import silence  # noqa: E402
from mlsroad_pipeline.hooks.mlflow_run import MlflowDetailsHooks  # noqa: E402
from mlsroad_pipeline.hooks.plain_logs import install  # noqa: E402
from mlsroad_pipeline.hooks.progress import ProgressHooks  # noqa: E402
from mlsroad_pipeline.hooks.stage_costs import StageCostsHooks  # noqa: E402

silence()
install()

HOOKS = (
    MlflowDetailsHooks(),
    DefaultPipelineHooks(),
    StageCostsHooks(),
    ProgressHooks(),
    LabelRunHooks(),
    early_workers,
    ClosingLinesHooks(),
)

CONFIG_LOADER_CLASS = ParameterConfigLoader
CONFIG_LOADER_ARGS = {
    "base_env": "base",
    "default_run_env": "local",
    # An environment changes single keys of a parameter group and inherits the others.
    "merge_strategy": {"parameters": "soft", "catalog": "soft"},
    "config_patterns": {"mlflow": ["mlflow*", "mlflow*/**", "**/mlflow*"]},
    # Roots of public datasets come from $MLSROAD_DATA.
    "custom_resolvers": {"oc.env": oc.env},
}
