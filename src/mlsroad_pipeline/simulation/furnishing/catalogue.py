"""Catalogue of all designs of street objects, by class."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation import objects
from mlsroad_pipeline.simulation.model.meshes import Design, Mesh


@cache
def designs() -> dict[str, tuple[Design, ...]]:
    """Return all designs of the package `objects` by the class of the whole, in the order of their modules."""
    catalogue: list[Design] = []
    for module in sorted(m.name for m in pkgutil.iter_modules(objects.__path__)):
        catalogue += getattr(import_module(f"{objects.__name__}.{module}"), "DESIGNS", ())
    names = [design.name for design in catalogue]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ParameterError(f"names of designs must be unique, repeated: {', '.join(twice)}")
    return {label: tuple(d for d in catalogue if d.label == label) for label in sorted({d.label for d in catalogue})}


def choose(label: str, rng: np.random.Generator, name: str | None = None) -> Design:
    """Choose a design of a class by weight, or by name; raises ParameterError if there is none."""
    known = designs().get(label, ())
    if not known:
        raise ParameterError(f"class {label!r} has no design (classes: {', '.join(designs())})")
    if name is None:
        weights = np.cumsum([design.weight for design in known])
        return known[int(np.searchsorted(weights, rng.random() * weights[-1], side="right"))]
    for design in known:
        if design.name == name:
            return design
    raise ParameterError(f"class {label!r} has no design {name!r} (designs: {', '.join(d.name for d in known)})")


def draw(label: str, rng: np.random.Generator, name: str | None = None) -> Mesh:
    """Draw an object of a class, by weight or by the name of its design; see `Design.build`."""
    return choose(label, rng, name).build(rng)
