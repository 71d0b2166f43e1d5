"""Fusion as a model: fitted on test set 1, applied to scenes that both methods have labelled."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions, PointLabels
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.core.validation import parse_groups
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.pool.log_linear import PoolParameters
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import TwoMethodFusion, spread_confidence

SLUG = "fusion"


@dataclass(frozen=True)
class FusionParameters:
    """Parameters of the fusion."""

    share: float = 0.5  # Share of each drive's scenes, from its beginning, in test set 1; the rest is test set 2
    pool: PoolParameters = field(default_factory=PoolParameters)  # Parameters of the log-linear pool

    def __post_init__(self) -> None:
        parse_groups(self, pool=PoolParameters)
        if not 0 < self.share < 1:
            raise ParameterError(f"share must be in (0, 1), got {self.share!r}")


class FusionSample(TypedDict):
    """Predictions of both methods for the core points of a scene of test set 1, with the reference."""

    labels: NDArray[np.int16]  # Labels of the feature-based method, -1 for none
    confidence: NDArray[np.float32]  # Their confidence, 0 to 1
    cameras: NDArray[np.float16]  # Class probabilities of each camera; NaN where it does not see the point
    reference: NDArray[np.int16]  # True labels, -1 for none


class FusedSceneLabels(PointLabels):
    """Fused labels of a scene's points, with the labels of the single methods."""

    pool_label: NDArray[np.int16]  # Labels of the log-linear pool, -1 for none
    image_label: NDArray[np.int16]  # Labels chosen among the cameras, -1 where no camera sees the point
    feature_label: NDArray[np.int16]  # Labels of the feature-based method, -1 for none
    seen: NDArray[np.bool_]  # Points that at least one camera sees


def divide_scenes(keys: Sequence[str], share: float) -> tuple[list[str], list[str]]:
    """Divide the scenes of each drive along the road."""
    drives: dict[str, list[str]] = {}
    for key in keys:
        drives.setdefault(SceneKey.parse(key).parent, []).append(key)
    if not drives:
        raise DataError("fusion needs scenes that the methods were not trained on")
    first, second = [], []
    for drive, scenes in drives.items():
        if len(scenes) < 2:
            raise DataError(f"drive {drive!r} has {len(scenes)} scene; test sets 1 and 2 need at least 2")
        cut = min(max(round(share * len(scenes)), 1), len(scenes) - 1)
        first += scenes[:cut]
        second += scenes[cut:]
    return first, second


def fusion_sample(
    scene: PointCloud, features: PointLabels, images: ImagePredictions, *, scheme: ClassScheme
) -> FusionSample:
    """Return the training sample of a scene of test set 1: its core points."""
    core = scene["core"]
    return {
        "labels": features["label"][core],
        "confidence": features["confidence"][core],
        "cameras": images["probabilities"][core],
        "reference": scheme.encode(scene["label"][core], source=scene.source),
    }


def fit(
    samples: Sequence[FusionSample], *, parameters: FusionParameters, scheme: ClassScheme, cameras: Sequence[str],
    trained_on: Mapping[str, Any],
) -> ModelBundle:  # fmt: skip
    """Fit class preferences and pool weights on test set 1."""
    labels = np.concatenate([sample["labels"] for sample in samples])
    confidence = np.concatenate([sample["confidence"] for sample in samples])
    probabilities = np.concatenate([sample["cameras"] for sample in samples])
    reference = np.concatenate([sample["reference"] for sample in samples])
    features = spread_confidence(labels, confidence, len(scheme))
    learned = TwoMethodFusion.fit(features, _by_camera(probabilities), reference, pool=parameters.pool)
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "cameras": list(cameras),
        "parameters": asdict(parameters),
        "attributes": [],
        "trained_on": {**trained_on, "points": int((reference != IGNORE).sum())},
    }
    return ModelBundle(SLUG, learned.to_arrays(), metadata)


def _by_camera(probabilities: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return probabilities with the cameras as first axis, in single precision."""
    return np.ascontiguousarray(probabilities.transpose(1, 0, 2), dtype=np.float32)


def fuse_scene(features: PointLabels, images: ImagePredictions, bundle: ModelBundle) -> FusedSceneLabels:
    """Fuse the labels of both methods."""
    cameras = _by_camera(images["probabilities"])
    single = spread_confidence(features["label"], features["confidence"], cameras.shape[2])
    fused = TwoMethodFusion.from_arrays(dict(bundle.arrays)).fuse(single, cameras)
    known = features["label"] != IGNORE
    rule, pool = (np.where(known, label, IGNORE).astype(np.int16) for label in (fused.rule, fused.pool))
    confidence = np.take_along_axis(fused.probabilities, np.maximum(rule, 0)[:, None].astype(np.int64), axis=1)[:, 0]
    return {
        "label": rule,
        "confidence": np.where(known, confidence, 0.0).astype(np.float32),
        "pool_label": pool,
        "image_label": fused.images,
        "feature_label": features["label"].astype(np.int16),
        "seen": fused.images != IGNORE,
    }
