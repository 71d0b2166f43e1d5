"""Code that MLflow stores beside a registered model and runs to load it."""

from mlflow.models import set_model

from mlsroad_pipeline.datasets.models.point_labeller import PointLabeller

set_model(PointLabeller())
