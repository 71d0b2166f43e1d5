"""Kedro pipelines: one module each, without array arithmetic."""
