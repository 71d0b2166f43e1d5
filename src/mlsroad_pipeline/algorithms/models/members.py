"""Models stored inside another model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.methods import METHODS


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
