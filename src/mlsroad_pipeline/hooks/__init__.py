"""Kedro hooks: MLflow records, progress, stage costs and the default pipeline."""
