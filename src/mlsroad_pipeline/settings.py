"""Project settings: where configuration comes from and which hooks run."""

import sys
import warnings

from mlsroad_pipeline.hooks.early_workers import start_early

early = start_early(sys.argv)  # before the imports below, which take seconds

from omegaconf.resolvers import oc  # noqa: E402

from mlsroad_pipeline.config import ParameterConfigLoader  # noqa: E402
from mlsroad_pipeline.hooks.command_hooks import EarlyWorkersHooks  # noqa: E402
from mlsroad_pipeline.hooks.default_pipeline import DefaultPipelineHooks  # noqa: E402
from mlsroad_pipeline.hooks.mlflow_run import MlflowDetailsHooks  # noqa: E402
from mlsroad_pipeline.hooks.progress import ProgressHooks  # noqa: E402
from mlsroad_pipeline.hooks.stage_costs import StageCostsHooks  # noqa: E402

# The dots in names of datasets are what catalog factories such as "{method}.labels" go by; every command would warn.
warnings.filterwarnings("ignore", message="One or more dataset names contain '.'", category=UserWarning)

HOOKS = (MlflowDetailsHooks(), DefaultPipelineHooks(), StageCostsHooks(), ProgressHooks(), EarlyWorkersHooks(early))

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
