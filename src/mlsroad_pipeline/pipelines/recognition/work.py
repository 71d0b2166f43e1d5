"""What workers do with sets of objects: recognise them with a stored model."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.recognition.recogniser import recognise_objects
from mlsroad_pipeline.datasets.models.model_bundle_dataset import open_model


def recognise_with_model(objects: Mapping[str, NDArray], model: str) -> dict[str, NDArray]:
    """Recognise the objects of a scene with a stored model."""
    return recognise_objects(objects, open_model(model))
