"""Fusion as a model: fitted on test set 1, applied to scenes that both methods have labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.labels import ImagePredictions, PointLabels
from mlsroad_pipeline.algorithms.core.parameter_groups import parse_groups
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.pool.log_linear import PoolParameters
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import TwoMethodFusion, spread_confidence

SLUG = "fusion"


@dataclass(frozen=True)
class FusionParameters:
    """Parameters of the fusion.

    Parameters
    ----------
    share : float, default 0.5
        Share of each drive's scenes, from its beginning, in test set 1; the rest is test set 2.
    pool : PoolParameters or mapping
        Parameters of the log-linear pool.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    share: float = 0.5
    pool: PoolParameters = field(default_factory=PoolParameters)

    def __post_init__(self) -> None:
        parse_groups(self, pool=PoolParameters)
        if not 0 < self.share < 1:
            raise ParameterError(f"share must be in (0, 1), got {self.share!r}")


class FusionSample(TypedDict):
    """Predictions of both methods for the core points of a scene of test set 1, with the reference.

    Attributes
    ----------
    labels : ndarray of int16, shape (n,)
        Labels of the feature-based method, -1 for none.
    confidence : ndarray of float32, shape (n,)
        Their confidence, 0 to 1.
    cameras : ndarray of float16, shape (n, groups, classes)
        Class probabilities of each camera; NaN where it does not see the point.
    reference : ndarray of int16, shape (n,)
        True labels, -1 for none.
    """

    labels: NDArray[np.int16]
    confidence: NDArray[np.float32]
    cameras: NDArray[np.float16]
    reference: NDArray[np.int16]


class FusedSceneLabels(PointLabels):
    """Fused labels of a scene's points, with the labels of the single methods.

    Attributes
    ----------
    pool_label : ndarray of int16, shape (n,)
        Labels of the log-linear pool, -1 for none.
    image_label : ndarray of int16, shape (n,)
        Labels chosen among the cameras, -1 where no camera sees the point.
    feature_label : ndarray of int16, shape (n,)
        Labels of the feature-based method, -1 for none.
    seen : ndarray of bool, shape (n,)
        Points that at least one camera sees.
    """

    pool_label: NDArray[np.int16]
    image_label: NDArray[np.int16]
    feature_label: NDArray[np.int16]
    seen: NDArray[np.bool_]


def divide_scenes(keys: Sequence[str], share: float) -> tuple[list[str], list[str]]:
    """Divide the scenes of each drive along the road.

    Parameters
    ----------
    keys : sequence of str
        Keys of scenes, see `SceneKey`, in the order of the road.
    share : float
        Share of each drive's scenes, from its beginning, in the first set.

    Returns
    -------
    first, second : list of str
        Test sets 1 and 2; each has at least one scene of every drive.

    Raises
    ------
    DataError
        If a drive has a single scene, or there are no scenes.
    """
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
    """Return the training sample of a scene of test set 1: its core points.

    Parameters
    ----------
    scene : PointCloud
        The scene, with columns `label` and `core`.
    features : PointLabels
        Labels of the feature-based method.
    images : ImagePredictions
        Predictions of the cameras.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    FusionSample
        Predictions and reference of the core points.

    Raises
    ------
    UnknownClassError
        If the scheme does not name a code.
    """
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
    """Fit class preferences and pool weights on test set 1.

    Parameters
    ----------
    samples : sequence of FusionSample
        One sample per scene of test set 1.
    parameters : FusionParameters
        Parameters of the fusion.
    scheme : ClassScheme
        The classes.
    cameras : sequence of str
        Names of the cameras.
    trained_on : mapping
        Metadata of the training data; JSON values.

    Returns
    -------
    ModelBundle
        The model, for the registry.

    Raises
    ------
    DataError
        If no point is labelled.
    """
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
    """Fuse the labels of both methods.

    Parameters
    ----------
    features : PointLabels
        Labels of the feature-based method.
    images : ImagePredictions
        Predictions of the cameras.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    FusedSceneLabels
        ``label`` is that of the class preference, ``confidence`` the pool's probability of it. Points that the
        feature-based method does not label have none.

    Raises
    ------
    DataError
        If the cameras differ from those of test set 1.
    """
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
