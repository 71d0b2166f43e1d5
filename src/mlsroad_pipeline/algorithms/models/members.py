"""Models that a model works with, stored in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under


def with_members(bundle: ModelBundle, members: Mapping[str, ModelBundle]) -> ModelBundle:
    """Put the models that a model works with into it, so that it can be used without them.

    Parameters
    ----------
    bundle : ModelBundle
        The model.
    members : mapping of str to ModelBundle
        Slug to model. The first one prepares the scenes: its `attributes` and its ground filter become the whole's.

    Returns
    -------
    ModelBundle
        The model with its members; `member` gives them back.

    Raises
    ------
    DataError
        If a member has other classes.
    """
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
    """Return one of the models that a model works with.

    Parameters
    ----------
    bundle : ModelBundle
        A model of `with_members`, or the one that is asked for itself.
    slug : str
        The member.

    Returns
    -------
    ModelBundle
        The member.

    Raises
    ------
    ParameterError
        If the model does not hold it.
    """
    if bundle.slug == slug:
        return bundle
    described = bundle.metadata.get("members", {}).get(slug)
    if described is None:
        raise ParameterError(f"model {bundle.slug!r} holds no {slug!r}: train it again with this version")
    return ModelBundle(slug, arrays_under(bundle.arrays, f"{slug}/"), described)
