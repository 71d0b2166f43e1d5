"""Labelling of points by a trained model with its method, and models that are stored inside another model."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ParameterError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under, model_source
from mlsroad_pipeline.algorithms.models.methods import METHODS, Method

Labeller = Callable[[PointCloud, ModelBundle], tuple[NDArray[np.integer], NDArray[np.floating]]]


class SoftLabels(NamedTuple):
    """Labels of a cloud of n points, with class probabilities where the method has them."""

    labels: NDArray[np.int16]  # Classes; -1 for none
    confidence: NDArray[np.float32]  # 0 to 1
    probabilities: NDArray[np.float32] | None = None  # Class probabilities of m voxels or points
    owner: NDArray[np.integer] | None = None  # Row of `probabilities` of each point, -1 for none


def labels_of_rows(
    best: NDArray[np.int16],
    confidence: NDArray[np.float32],
    probabilities: NDArray[np.floating],
    owner: NDArray[np.int32],
) -> SoftLabels:
    """Return the labels of points from those of rows of probabilities."""
    # Points without a row take the last element.
    label, sure = (np.append(values, default) for values, default in ((best, IGNORE), (confidence, 0)))
    return SoftLabels(
        label.astype(np.int16)[owner], sure.astype(np.float32)[owner], probabilities.astype(np.float32), owner
    )


def label_cloud(
    bundle: ModelBundle, cloud: PointCloud, *, labeller: Labeller | None = None
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Label a cloud with a model."""
    if labeller is None and method_of(bundle).label_softly:
        return label_softly(bundle, cloud)[:2]
    return _checked(bundle, cloud, *_applied(bundle, cloud, labeller or method_of(bundle).load("label_cloud")))


def label_softly(bundle: ModelBundle, cloud: PointCloud, *, labeller: Labeller | None = None) -> SoftLabels:
    """Label a cloud with a model, and return the class probabilities if the method has any."""
    if labeller is not None or not method_of(bundle).label_softly:
        return SoftLabels(*label_cloud(bundle, cloud, labeller=labeller))
    soft: SoftLabels = _applied(bundle, cloud, method_of(bundle).load("label_softly"))
    return SoftLabels(*_checked(bundle, cloud, *soft[:2]), *soft[2:])


def method_of(bundle: ModelBundle) -> Method:
    """Return the method of a model; ParameterError if this version of the package does not have it."""
    if bundle.slug not in METHODS:
        source = model_source(bundle)
        name = f"{source['name']} {source['version']}".strip()
        raise ParameterError(
            f"model {name!r}: unknown method {bundle.slug!r} (known: {', '.join(METHODS)}); train a model of a known "
            "method: kedro run --pipelines=SLUG"
        )
    return METHODS[bundle.slug]


def _applied(bundle: ModelBundle, cloud: PointCloud, function: Callable[[PointCloud, ModelBundle], Any]) -> Any:
    """Call a function of a method; arrays of unexpected types or shapes raise errors of many kinds."""
    try:
        return function(cloud, bundle)
    except (MlsRoadError, MemoryError, OSError):
        raise
    except Exception as error:  # of NumPy, PyTorch, Numba
        cause = shortened(printable(error), 200)
        raise DataError(
            f"{cloud.source}: model {bundle.slug!r} fails with {type(error).__name__}: {cause}; its "
            "arrays do not fit its method, or the method has a fault"
        ) from error


def _checked(
    bundle: ModelBundle, cloud: PointCloud, labels: ArrayLike, confidence: ArrayLike
) -> tuple[NDArray[np.int16], NDArray[np.float32]]:
    """Return the result of a labeller with its types, or raise an error."""
    labels, confidence = np.asarray(labels), np.asarray(confidence)
    if labels.shape != (len(cloud),) or confidence.shape != (len(cloud),):
        raise DataError(
            f"model {bundle.slug!r} returned labels {labels.shape} and confidences {confidence.shape} "
            f"for the {len(cloud)} points of {cloud.source}"
        )
    if len(confidence) and not (confidence.min() >= 0 and confidence.max() <= 1):  # NaN fails both
        wrong = confidence[~((confidence >= 0) & (confidence <= 1))][0]
        raise DataError(f"model {bundle.slug!r} returned a confidence of {wrong:g}: the model is damaged")
    if len(labels) and not (labels.min() >= -1 and labels.max() < len(bundle.classes)):
        raise DataError(
            f"model {bundle.slug!r} returned labels {labels.min()}..{labels.max()} of {len(bundle.classes)} classes"
        )
    return labels.astype(np.int16, copy=False), confidence.astype(np.float32, copy=False)


def with_members(bundle: ModelBundle, members: Mapping[str, ModelBundle]) -> ModelBundle:
    """Store other models in a model, so that it can be used without their files."""
    arrays, described = dict(bundle.arrays), {}
    for slug, one in members.items():
        if one.classes != bundle.classes:
            raise DataError(f"model {bundle.slug!r} has classes {bundle.classes}, its member {slug!r} {one.classes}")
        arrays |= {f"{slug}/{name}": values for name, values in one.arrays.items()}
        described[slug] = dict(one.metadata)
    first = next(iter(described.values()))
    parameters = dict(bundle.metadata.get("parameters", {}))
    if "ground" in first.get("parameters", {}):
        parameters["ground"] = first["parameters"]["ground"]
    metadata = {
        **bundle.metadata,
        "attributes": first.get("attributes", []),
        "parameters": parameters,
        "members": described,
    }
    return replace(bundle, arrays=arrays, metadata=metadata)


def member(bundle: ModelBundle, slug: str) -> ModelBundle:
    """Return a model that is stored in another one."""
    if bundle.slug == slug:
        return bundle
    if slug not in bundle.metadata.get("members", {}):
        raise ParameterError(f"model {bundle.slug!r} has no member {slug!r}; train it again with this version")
    return stored_member(bundle, slug)


def stored_member(bundle: ModelBundle, name: str) -> ModelBundle:
    """Return the model that is stored in another one by its name, which is its slug unless its metadata have one."""
    stored = bundle.metadata["members"][name]
    metadata = {key: value for key, value in stored.items() if key != "slug"}
    return ModelBundle(str(stored.get("slug", name)), arrays_under(bundle.arrays, f"{name}/"), metadata)


def context_of(bundle: ModelBundle) -> float:
    """Return the distance beyond a scene up to which points improve its labels."""
    members: Mapping[str, Any] = bundle.metadata.get("members", {})
    slugs = {bundle.slug, *(str(stored.get("slug", name)) for name, stored in members.items())}
    return max((METHODS[slug].context for slug in slugs if slug in METHODS), default=0.0)
