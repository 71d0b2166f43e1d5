"""Model that a run of `label` requests, and the images that are segmented in place of its own network."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS
from mlsroad_pipeline.label.models.choice import ModelChoice, load_choice
from mlsroad_pipeline.label.models.selection import choose_model
from mlsroad_pipeline.model_store.registered_models import configured_store

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelRequest:
    """Model that a run of `label` requests."""

    method: str | None = None  # Method of the model
    choice: ModelChoice | None = None  # The model; the shipped one of the method by default
    images: Any = None  # Segmentation of images in place of the network of the model
    own: ModelBundle | None = None  # A model that the configuration makes, in place of a registered one
    device: str = "auto"  # Where images are segmented

    def bundle(self) -> tuple[ModelBundle, str]:
        """Return the model and a line for the log."""
        if self.own is not None:
            source = self.own.metadata["segmentation"]["name"]
            return self.own, f"Labelling with image_labels ({source}): image_labels.masks or .weights names it"
        choice = self.choice or choose_model(method=self.method)
        bundle = _segmentation("with_device")(load_choice(choice, configured_store()), self.device)
        if self.images is not None:
            bundle = _segmentation("with_own_segmentation")(bundle, self.images)
        return bundle, f"Labelling with {choice.name} ({bundle.slug}, {choice.trained_on}): {choice.reason}"


def image_request(request: ModelRequest, images: Any, schemes: Mapping[str, Any]) -> ModelRequest:
    """Return a request with the masks or the weights that the configuration names for `image_labels` or `fusion`."""
    if not images.own_segmentation:
        return replace(request, device=images.device)
    given = "masks" if images.masks is not None else "weights"
    chosen = request.choice.method if request.choice else request.method
    if chosen == "fusion":
        logger.warning(
            "The fusion was learned with another segmentation than %s unless it was trained with the same",
            images.masks or images.weights,
        )
        return replace(request, images=images)
    if chosen == "image_labels" and request.choice is not None:
        named = f"{request.choice.name} ({request.choice.reason})"
        raise ParameterError(
            f"image_labels.{given} takes the place of {named}: set label.model to null and label.method to "
            f"image_labels (image_labels.scheme has the classes), or image_labels.{given} to null"
        )
    if request.method == "image_labels":
        return replace(request, own=_segmentation("own_model")(images, find_scheme(schemes, images.scheme)))
    raise ParameterError(f"image_labels.{given} is set: use label.method=image_labels or fusion, or set it to null")


def _segmentation(name: str) -> Any:
    """Return a function of the method `image_labels` that changes where the images of a model are segmented."""
    return METHODS["image_labels"].function(f".own_segmentation:{name}")
