"""Code that MLflow stores beside a registered model and runs to load it."""

from mlflow.models import set_model

from mlsroad_pipeline.model_store.point_labeller import PointLabeller

set_model(PointLabeller())
