"""Kedro hooks: MLflow records, progress, stage costs, the default pipeline and early workers."""
