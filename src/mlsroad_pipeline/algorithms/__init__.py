"""The science of mlsroad: NumPy in, NumPy out. Imports neither Kedro nor MLflow."""
