"""The fusion as a model: learned on test set 1, and applied to scenes that both methods have labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.fusion.log_linear_pool import PoolParameters
from mlsroad_pipeline.algorithms.fusion.two_methods import TwoMethodFusion, spread_confidence
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle

SLUG = "fusion"


@dataclass(frozen=True)
class FusionParameters:
    """How the fusion learns.

    Parameters
    ----------
    share : float, default 0.5
        Share of each drive's scenes, from its beginning, that are test set 1; the rest is test set 2.
    pool : PoolParameters or mapping
        Of the probabilistic fusion.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    share: float = 0.5
    pool: PoolParameters = field(default_factory=PoolParameters)

    def __post_init__(self) -> None:
        if isinstance(self.pool, Mapping):
            object.__setattr__(self, "pool", PoolParameters(**self.pool))
        if not 0 < self.share < 1:
            raise ParameterError(f"share must be in (0, 1), got {self.share!r}")


def divide_scenes(keys: Sequence[str], share: float) -> tuple[list[str], list[str]]:
    """Divide the scenes of each drive along the road.

    Parameters
    ----------
    keys : sequence of str
        Keys of scenes (`SceneKey`), in the order of the road.
    share : float
        Share of each drive's scenes, from its beginning, in the first set.

    Returns
    -------
    first, second : list of str
        Test sets 1 and 2; each has a scene of every drive.

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
    for drive, mine in drives.items():
        if len(mine) < 2:
            raise DataError(f"drive {drive!r} has {len(mine)} scene, which cannot be divided into test sets 1 and 2")
        cut = min(max(round(share * len(mine)), 1), len(mine) - 1)
        first += mine[:cut]
        second += mine[cut:]
    return first, second


def core_answers(
    scene: PointCloud, features: Mapping[str, NDArray], images: Mapping[str, NDArray], *, scheme: ClassScheme
) -> dict[str, NDArray]:
    """Take what the fusion learns from a scene of test set 1.

    Parameters
    ----------
    scene : PointCloud
        The scene, with `label` and `core`.
    features : mapping
        ``label`` and ``confidence`` (n,) of the method that knows features.
    images : mapping
        ``probabilities`` (n, groups, classes) of the cameras.
    scheme : ClassScheme
        The classes.

    Returns
    -------
    dict of str to ndarray
        ``labels``, ``confidence``, ``cameras`` (n, groups, classes) and ``reference`` of the core points.

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
    answers: Sequence[Mapping[str, NDArray]], *, parameters: FusionParameters, scheme: ClassScheme,
    cameras: Sequence[str], trained_on: Mapping[str, Any],
) -> ModelBundle:  # fmt: skip
    """Learn preferences and weights on test set 1.

    Parameters
    ----------
    answers : sequence of mapping
        What `core_answers` gave for each scene of test set 1.
    parameters : FusionParameters
        How.
    scheme : ClassScheme
        The classes.
    cameras : sequence of str
        Names of the cameras.
    trained_on : mapping
        What the model's metadata say of the training data; JSON values.

    Returns
    -------
    ModelBundle
        The model, for the registry.

    Raises
    ------
    DataError
        If no point is labelled.
    """
    joined = {name: np.concatenate([part[name] for part in answers]) for name in answers[0]}
    features = spread_confidence(joined["labels"], joined["confidence"], len(scheme))
    learned = TwoMethodFusion.fit(
        features, _by_camera(joined["cameras"]), joined["reference"], pool=parameters.pool
    )  # fmt: skip
    metadata = {
        "classes": list(scheme.classes),
        "scheme": asdict(scheme),
        "cameras": list(cameras),
        "parameters": asdict(parameters),
        "attributes": [],
        "trained_on": {**trained_on, "points": int((joined["reference"] != IGNORE).sum())},
    }
    return ModelBundle(SLUG, learned.to_arrays(), metadata)


def _by_camera(probabilities: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the cameras first and in single precision, as the fusion takes them."""
    return np.ascontiguousarray(probabilities.transpose(1, 0, 2), dtype=np.float32)


def fuse_scene(
    features: Mapping[str, NDArray], images: Mapping[str, NDArray], bundle: ModelBundle
) -> dict[str, NDArray]:
    """Fuse what both methods say of a scene.

    Parameters
    ----------
    features : mapping
        ``label`` and ``confidence`` (n,) of the method that knows features.
    images : mapping
        ``probabilities`` (n, groups, classes) of the cameras.
    bundle : ModelBundle
        A model of `fit`.

    Returns
    -------
    dict of str to ndarray
        ``label`` int16 (n,) by class preference, and ``confidence`` float32 (n,), the pool's probability of it;
        ``pool_label``, ``image_label`` and ``feature_label`` int16 (n,) of the pool, the choice among the cameras and
        the other method; ``seen`` bool (n,). Points without a label of the features have none.

    Raises
    ------
    DataError
        If there are other cameras than on test set 1.
    """
    cameras = _by_camera(images["probabilities"])
    given = spread_confidence(features["label"], features["confidence"], cameras.shape[2])
    found = TwoMethodFusion.from_arrays(dict(bundle.arrays)).fuse(given, cameras)
    known = features["label"] != IGNORE
    rule, pool = (np.where(known, label, IGNORE).astype(np.int16) for label in (found.rule, found.pool))
    confidence = np.take_along_axis(found.probabilities, np.maximum(rule, 0)[:, None].astype(np.int64), axis=1)[:, 0]
    return {
        "label": rule,
        "confidence": np.where(known, confidence, 0.0).astype(np.float32),
        "pool_label": pool,
        "image_label": found.images,
        "feature_label": features["label"].astype(np.int16),
        "seen": found.images != IGNORE,
    }
