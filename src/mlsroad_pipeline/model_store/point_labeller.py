"""MLflow flavour of a model: a table of points in, a class and a confidence per point out."""

from typing import Any

import mlflow.pyfunc
import numpy as np
import pandas as pd
from mlflow.models import ModelSignature
from mlflow.types import ColSpec, ParamSchema, Schema

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MissingColumnError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.model_store.bundle_files import load_bundle

UNLABELLED = "unlabelled"
"""Class name of points without a label."""

_XYZ, _RGB = ["x", "y", "z"], ["red", "green", "blue"]


def signature() -> ModelSignature:
    """Return the signature of every registered model."""
    inputs = [ColSpec("double", name) for name in _XYZ]
    inputs += [ColSpec("long", name, required=False) for name in _RGB]
    inputs.append(ColSpec("double", "intensity", required=False))
    outputs = [ColSpec("integer", "label"), ColSpec("string", "class"), ColSpec("double", "confidence")]
    return ModelSignature(inputs=Schema(inputs), outputs=Schema(outputs), params=ParamSchema([]))


def table_to_cloud(table: pd.DataFrame, *, source: str = "model input") -> PointCloud:
    """Convert a table of points to a cloud."""
    columns = {}
    for group in (_XYZ, _RGB, ["intensity"]):
        absent = [name for name in group if name not in table.columns]
        if absent and (group is _XYZ or len(absent) < len(group)):
            raise MissingColumnError(f"{source} has no column {absent[0]!r} (columns: {', '.join(table.columns)})")
        if absent:
            continue
        values = table[group].to_numpy(dtype=np.float64)
        bad = ~np.isfinite(values)
        if group is not _XYZ:
            bad |= (values < 0) | (values > (255 if group is _RGB else 1))
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise DataError(f"{source}: {group[column]} is {values[row, column]} in row {row}")
        columns[group[0]] = values
    xyz = columns.pop("x")
    origin = np.floor(xyz.min(axis=0)) if len(xyz) else np.zeros(3)
    attributes: dict[str, Any] = {}
    if "red" in columns:
        attributes["rgb"] = columns["red"].astype(np.uint8)
    if "intensity" in columns:
        attributes["intensity"] = columns["intensity"][:, 0].astype(np.float32)
    return PointCloud(xyz - origin, attributes, origin, source=source)


class PointLabeller(mlflow.pyfunc.PythonModel):
    """The pyfunc of every registered model. The method is that of the model's slug."""

    def __init__(self) -> None:
        self.bundle: ModelBundle | None = None

    def load_context(self, context: mlflow.pyfunc.PythonModelContext) -> None:
        """Read the model's files."""
        self.bundle = load_bundle(context.artifacts["bundle"])

    def predict(
        self, context: mlflow.pyfunc.PythonModelContext, model_input: pd.DataFrame, params: dict[str, Any] | None = None
    ) -> pd.DataFrame:
        """Label points."""
        if self.bundle is None:
            self.load_context(context)
        assert self.bundle is not None  # set by load_context
        labels, confidence = label_cloud(self.bundle, table_to_cloud(model_input))
        names = np.array([*self.bundle.classes, UNLABELLED], dtype=object)
        result = {"label": labels.astype(np.int32), "class": names[labels], "confidence": confidence.astype(np.float64)}
        return pd.DataFrame(result, index=model_input.index)
