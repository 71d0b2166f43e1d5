"""The science of mlsroad: NumPy in, NumPy out. Knows nothing of Kedro or MLflow."""
