"""Kedro hooks: MLflow records, progress, stage costs, the default pipeline and records of `label`."""
