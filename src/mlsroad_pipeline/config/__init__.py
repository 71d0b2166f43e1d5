"""Configuration of the project: loader of its files, and the context of a run."""

from mlsroad_pipeline.config.loader import ParameterConfigLoader, check_names, with_layers

__all__ = ["ParameterConfigLoader", "check_names", "with_layers"]
