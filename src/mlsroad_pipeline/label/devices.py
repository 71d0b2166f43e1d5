"""Device of the networks of a model, found before the workers use it."""

from collections.abc import Iterator, Mapping
from importlib.metadata import version
from typing import Any

from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.labelling import member
from mlsroad_pipeline.algorithms.models.methods import METHODS

_IMAGES = "image_labels"


def check_device(bundle: ModelBundle) -> None:
    """Raise ParameterError for a device that is missing, and warn of a GPU that fails; workers print no warnings."""
    for source, device in _devices(bundle):
        if source == "onnx":
            METHODS[_IMAGES].function(".segmentation:segmenter_of")(
                bundle if bundle.slug == _IMAGES else member(bundle, _IMAGES)
            )
        elif source != "masks" and (device == "cuda" or not version("torch").endswith("+cpu")):
            from mlsroad_pipeline.algorithms.models.machines.torch_training import find_device  # noqa: PLC0415  it imports torch

            find_device(device)


def _devices(bundle: ModelBundle) -> Iterator[tuple[str | None, str]]:
    """Yield the source of the segmentation, if there is one, and the device of each network of a model."""
    members: Mapping[str, Any] = bundle.metadata.get("members", {})
    for metadata in (bundle.metadata, *members.values()):
        parameters = metadata.get("parameters", {})
        recogniser = parameters.get("recogniser", {})
        for owner in (parameters, recogniser, recogniser.get("training", {})):
            if "device" in owner:
                yield metadata.get("segmentation", {}).get("source"), str(owner["device"])
