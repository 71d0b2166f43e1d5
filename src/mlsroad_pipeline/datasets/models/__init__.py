"""Kedro datasets of trained models, on disk and in the MLflow registry."""
