"""A registered model on a scene that it has never seen: labels for its points, objects for the inventory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.extraction import SceneObjects, extract_objects
from mlsroad_pipeline.algorithms.inventory.merging import merge_across_scenes
from mlsroad_pipeline.algorithms.inventory.rules import ObjectRule, rules_for_scheme
from mlsroad_pipeline.algorithms.inventory.table import OBJECT_FIELDS
from mlsroad_pipeline.algorithms.models.bundle import Labeller, ModelBundle, bundle_scheme, label_cloud
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory
from mlsroad_pipeline.algorithms.stages import GroundParameters, find_ground, inliers
from mlsroad_pipeline.label.confidence import count_confidences

UNCLASSIFIED, NOISE = 1, 7
"""LAS codes of points without a class and of outliers."""


def label_new_scene(
    scene: PointCloud,
    bundle: ModelBundle,
    *,
    codes: NDArray[np.uint8],
    rules: Mapping[str, ObjectRule],
    ground: GroundParameters,
    name: str,
    labeller: Labeller | None = None,
) -> dict[str, Any]:
    """Label the points of a scene and find the objects among them."""
    stored = bundle.metadata.get("parameters", {}).get("ground")
    found_ground = find_ground(scene, ground if stored is None else GroundParameters(**stored))
    label, confidence = label_cloud(bundle, scene.with_columns(**found_ground), labeller=labeller)
    core = scene["core"]
    table = np.append(codes, np.uint8(UNCLASSIFIED))
    code = table[label]
    code[~inliers(scene)] = NOISE
    files, rows = scene["file"][core], scene["row"][core]
    starts = np.flatnonzero(np.diff(files, prepend=-1))  # scenes are ordered by file, and within one by row
    ends = np.append(starts[1:], len(files)) - 1
    core_label, core_confidence = label[core], confidence[core].astype(np.float32)
    found = _objects(scene, label, confidence, height=found_ground["height"], rules=rules, name=name)
    n_classes = len(codes)
    return {
        "labels": {
            "file": files,
            "row": rows,
            "code": code[core],
            "confidence": core_confidence,
        },
        "spans": {"spans": np.column_stack([files[starts], rows[starts], rows[ends]]).astype(np.int64)},
        "counts": {
            "counts": np.bincount(np.where(core_label < 0, n_classes, core_label), minlength=n_classes + 1),
            "confidences": count_confidences(core_label, core_confidence, n_classes),
        },
        "objects": found.objects,
        "fragments": found.fragments,
    }


def _objects(
    scene: PointCloud,
    label: NDArray[np.integer],
    confidence: NDArray[np.floating],
    *,
    height: NDArray[np.float32],
    rules: Mapping[str, ObjectRule],
    name: str,
) -> SceneObjects:
    known = np.isfinite(height)
    return extract_objects(
        scene.xyz,
        np.where(known, label, -1) if known.any() else label,
        confidence,
        classes=rules,
        core=scene["core"],
        origin=scene.origin,
        height_above_ground=np.where(known, height, 0.0) if known.any() else None,
        scene=name,
    )


def object_rules(bundle: ModelBundle, changes: Mapping[str, Any]) -> dict[str, ObjectRule]:
    """Return what makes an object of which of a model's classes."""
    return rules_for_scheme(bundle_scheme(bundle), changes=changes)


def join_inventories(
    drives: Sequence[tuple[Sequence[SceneObjects], Trajectory | None]], rules: Mapping[str, ObjectRule]
) -> pd.DataFrame:
    """Make one inventory from what the scenes of several drives found."""
    tables: list[pd.DataFrame] = []
    last = 0
    for scenes, trajectory in drives:
        table = merge_across_scenes(scenes, classes=rules, trajectory=trajectory)
        table["object_id"] += last
        table.loc[table["pole_id"] > 0, "pole_id"] += last
        last += len(table)
        tables.append(table)
    filled = [table for table in tables if len(table)]
    joined = pd.concat(filled, ignore_index=True) if filled else tables[0]
    return joined[list(OBJECT_FIELDS)].astype(OBJECT_FIELDS)


def output_codes(bundle: ModelBundle, scheme: str, schemes: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return the LAS code that each of a model's classes is written as."""
    trained = bundle_scheme(bundle)
    if scheme == "asprs":
        return trained.codes()
    if scheme not in schemes:
        raise ParameterError(f"label.scheme {scheme!r} is not configured (schemes: {', '.join(schemes)})")
    return trained.codes(ClassScheme.from_config(scheme, schemes[scheme]))
