"""Project settings: the configuration loader and the hooks."""

import sys

from mlsroad_pipeline.hooks.early_start import is_label, start_workers

if is_label(sys.argv):
    start_workers()  # before the imports below; the module has the measured gain

from omegaconf.resolvers import oc

from mlsroad_pipeline.config import ParameterConfigLoader
from mlsroad_pipeline.hooks.default_pipeline import DefaultPipelineHooks
from mlsroad_pipeline.hooks.label_run import LabelRunHooks
from mlsroad_pipeline.hooks.mlflow_run import MlflowDetailsHooks
from mlsroad_pipeline.hooks.origin import OriginHooks
from mlsroad_pipeline.hooks.plain_logs import install, silence
from mlsroad_pipeline.hooks.progress import ClosingLinesHooks, ProgressHooks
from mlsroad_pipeline.hooks.stage_costs import StageCostsHooks

silence()
install()

HOOKS = (
    MlflowDetailsHooks(),
    OriginHooks(),
    DefaultPipelineHooks(),
    StageCostsHooks(),
    ProgressHooks(),
    LabelRunHooks(),
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
