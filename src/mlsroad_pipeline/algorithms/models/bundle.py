"""Trained models as plain data: named arrays and JSON values.

Nothing is pickled: a model from elsewhere runs no code but this package's own, and it outlives the versions of the
libraries that trained it.
"""

import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud


@dataclass(frozen=True)
class ModelBundle:
    """A trained model.

    Parameters
    ----------
    slug : str
        The method's slug, such as ``"detrended_forest"``.
    arrays : mapping of str to ndarray
        Learned arrays; no object arrays.
    metadata : mapping of str to any
        JSON values. Required: ``classes``, the class names in label order. `label` needs ``scheme``, the class scheme
        as a mapping of the fields of `ClassScheme`. Usual: ``attributes``, the columns beside the coordinates that the
        model uses where a survey has them; ``parameters``, of which ``ground`` are those of `GroundParameters`;
        ``trained_on``; ``feature_names``.

    Attributes
    ----------
    prepared : dict of str to any
        Objects that the method makes from the arrays once, such as a forest; they are not stored.

    Raises
    ------
    ParameterError
        If the slug or the classes are missing or malformed.
    DataError
        If an array holds Python objects, or the metadata are no JSON values.
    """

    slug: str
    arrays: Mapping[str, NDArray]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    prepared: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.slug):
            raise ParameterError(f"a model's slug has small letters, digits and _, got {self.slug!r}")
        classes = self.metadata.get("classes")
        if not isinstance(classes, list | tuple) or not classes or not all(isinstance(c, str) for c in classes):
            raise ParameterError(f"model {self.slug!r}: classes must be a list of names, got {classes!r}")
        for name, values in self.arrays.items():
            if np.asarray(values).dtype.hasobject:
                raise DataError(f"model {self.slug!r}: array {name!r} holds Python objects")
        try:
            json.dumps(dict(self.metadata), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise DataError(f"model {self.slug!r}: metadata must be JSON values: {error}") from error

    @property
    def classes(self) -> tuple[str, ...]:
        """Return the class names in label order."""
        return tuple(self.metadata["classes"])


def arrays_under(arrays: Mapping[str, NDArray], prefix: str) -> dict[str, NDArray]:
    """Return the arrays whose names begin with a prefix, such as those of a variant, by the rest of the name."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


def missing_attributes(bundle: ModelBundle, columns: Collection[str]) -> list[str]:
    """Return the columns beside the coordinates that a model was trained with and a survey lacks."""
    return [name for name in bundle.metadata.get("attributes", ()) if name not in columns]


def model_source(bundle: ModelBundle) -> dict[str, Any]:
    """Return name and version of a registered, shipped or stored model, else empty ones and its ``source``."""
    for source in ("registered", "shipped", "stored"):
        if source in bundle.metadata:
            return {**bundle.metadata[source], "source": source}
    return {"name": bundle.slug, "version": ""}


def bundle_scheme(bundle: ModelBundle) -> ClassScheme:
    """Return the class scheme that a model was trained on."""
    stored = bundle.metadata.get("scheme")
    if stored is None:
        raise ParameterError(f"model {bundle.slug!r} has no class scheme in its metadata: it cannot label a survey")
    try:
        classes = dict(zip(stored["classes"], zip(stored["members"], stored["asprs"], strict=True), strict=True))
        specs = {name: {"members": members, "asprs": code} for name, (members, code) in classes.items()}
        scheme = ClassScheme.from_config(str(stored["name"]), {"classes": specs, "ignore": stored["ignored"]})
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"model {bundle.slug!r}: its class scheme is damaged: {error}") from error
    if len(scheme) != len(stored["classes"]):
        raise ParameterError(f"model {bundle.slug!r}: its class scheme lists a class twice: {stored['classes']}")
    return scheme


def refuse_points(cloud: PointCloud, bundle: ModelBundle) -> NoReturn:
    """Raise an error: a model that needs images cannot label points alone."""
    raise ParameterError(f"{cloud.source}: model {bundle.slug!r} needs images; it cannot label points alone")


class Checkpoints(Protocol):
    """Storage of training states, one per training."""

    def load(self, name: str) -> dict[str, Any] | None:
        """Return a state, None if none was saved; raise ReadError if it is damaged."""

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Replace a state atomically."""

    def remove(self, name: str) -> None:
        """Remove a state if there is one."""

    def locate(self, name: str) -> str:
        """Return the place of a state for messages."""
