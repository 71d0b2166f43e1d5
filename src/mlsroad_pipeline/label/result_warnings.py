"""Warnings about the results of `label`."""

from __future__ import annotations

from collections.abc import Mapping

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.lines.kerbs.kerb_lines import ground_classes
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.label.confidence import confidence_table, confidence_warnings, ground_warnings
from mlsroad_pipeline.label.images import effect_without_images
from mlsroad_pipeline.label.scene import LabelCounts
from mlsroad_pipeline.label.summary import summed_counts
from mlsroad_pipeline.label.written_file import WrittenFile


def label_warnings(
    bundle: ModelBundle, counts: Mapping[str, LabelCounts], written: Mapping[str, WrittenFile]
) -> list[str]:
    """Return the warnings about the labels and the images."""
    scheme, confidences = bundle_scheme(bundle), summed_counts(written)["confidences"]
    return [
        *confidence_warnings(confidence_table(confidences, scheme.classes)),
        *ground_warnings(confidences, ground_classes(scheme)),
        *image_warnings(bundle, counts),
    ]


def image_warnings(bundle: ModelBundle, counts: Mapping[str, LabelCounts]) -> list[str]:
    """Return a warning for drives without images, for methods that use images."""
    without = list(dict.fromkeys(SceneKey.parse(key).parent for key, scene in counts.items() if "seen" not in scene))
    if not needs_images(bundle.slug) or not without:
        return []
    return [f"There are no images for {', '.join(without)}: {effect_without_images(bundle)}."]
