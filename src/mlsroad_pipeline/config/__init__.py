"""Configuration of the project: loader of its files, and the context of a run."""

from mlsroad_pipeline.config.loader import ParameterConfigLoader, with_layers

__all__ = ["ParameterConfigLoader", "with_layers"]
