"""Features of a candidate object: its measures, its shape and the evidence of the classes within and around it."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.evidence import GROUP_FEATURES, group_features
from mlsroad_pipeline.algorithms.inventory.objects.measures import ObjectMeasures
from mlsroad_pipeline.algorithms.inventory.objects.trunks import find_trunks, main_trunk
from mlsroad_pipeline.algorithms.inventory.objects.voxel_sums import Voxels

MEASURED = (
    "height", "width", "length", "tilt", "diameter", "crown_diameter", "panel_bottom", "panel_centre", "panel_height",
    "panel_width", "clearance", "visible_share", "extent",
)  # fmt: skip
"""Measures that are features."""

SHAPE = (
    "deviation_1", "deviation_2", "deviation_3", "linearity", "planarity", "plan_deviation_1", "plan_deviation_2",
    "span", "filled", "log_voxels", "log_points", "log_density", "radius_50", "radius_90", "low_width", "middle_width",
    "top_width", "low_share", "middle_share", "top_share", "foot_width",
)  # fmt: skip
"""Features of the shape; lengths in metres."""

TRUNK = ("trunk_width", "trunk_layers", "trunk_low", "trunk_log_voxels", "trunk_offset", "trunks")
"""Features of the trunks of a tree."""

FEATURES = (
    *GROUP_FEATURES,
    *MEASURED,
    *SHAPE,
    *TRUNK,
    "from_signs",
)
"""Names of the features."""

_LAYER, _FOOT = 0.25, 0.5


def object_features(
    voxels: Voxels, measures: ObjectMeasures, sums: NDArray[np.float64], *, from_signs: bool
) -> NDArray[np.float32]:
    """Return the features of an object."""
    values = [
        group_features(sums[None])[0],
        [float(measures.get(name, np.nan)) for name in MEASURED],  # type: ignore[arg-type]
        _shape(voxels),
        _of_trunks(voxels),
        [float(from_signs)],
    ]
    return np.concatenate([np.asarray(part, dtype=np.float64) for part in values]).astype(np.float32)


def _shape(voxels: Voxels) -> list[float]:
    xyz = voxels.xyz
    off = xyz - xyz.mean(axis=0)
    spread = off.T @ off / len(xyz)
    deviation = np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[::-1], 0.0))
    plan = np.sqrt(np.maximum(np.linalg.eigvalsh(spread[:2, :2])[::-1], 0.0))
    low, high = voxels.z_low.min(), voxels.z_high.max()
    span = max(float(high - low), 1e-3)
    layer = np.floor((xyz[:, 2] - low) / _LAYER).astype(np.int64)
    layer -= layer.min()
    radius = np.hypot(*(xyz[:, :2] - np.median(xyz[:, :2], axis=0)).T)
    third = np.clip(((xyz[:, 2] - low) / span * 3).astype(np.int64), 0, 2)
    widths = [float(np.quantile(radius[third == k], 0.8)) if (third == k).any() else np.nan for k in range(3)]
    foot = xyz[:, 2] < low + _FOOT
    longest = max(float(deviation[0]), 1e-6)
    return [
        *deviation.tolist(),
        float(deviation[0] - deviation[1]) / longest,
        float(deviation[1] - deviation[2]) / longest,
        *plan.tolist(),
        span,
        len(np.unique(layer)) / float(layer.max() + 1),
        float(np.log(len(xyz))),
        float(np.log(voxels.count.sum())),
        float(np.log(len(xyz) / span)),
        float(np.median(radius)),
        float(np.quantile(radius, 0.9)),
        *widths,
        *(float((third == k).mean()) for k in range(3)),
        float(np.hypot(*np.ptp(xyz[foot, :2], axis=0))) if foot.any() else np.nan,
    ]


def _of_trunks(voxels: Voxels) -> list[float]:
    trunks = find_trunks(voxels)
    best = main_trunk(trunks)
    if best is None:
        return [np.nan] * (len(TRUNK) - 1) + [0.0]
    offset = float(np.hypot(*(voxels.xyz[:, :2].mean(axis=0) - (best.x, best.y))))
    return [best.width, best.layers, best.low, float(np.log1p(len(best.voxels))), offset, float(len(trunks))]
