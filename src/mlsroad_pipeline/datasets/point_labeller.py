"""Earlier place of `PointLabeller`, from which the code stored beside registered models imports it."""

from mlsroad_pipeline.datasets.models.point_labeller import PointLabeller

__all__ = ["PointLabeller"]
