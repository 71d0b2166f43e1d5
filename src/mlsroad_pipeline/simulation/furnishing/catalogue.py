"""Catalogue of all designs of street objects, by class."""

import pkgutil
from functools import cache
from importlib import import_module

import numpy as np

from mlsroad_pipeline.simulation import objects
from mlsroad_pipeline.simulation.model.meshes import Design


@cache
def designs() -> dict[str, tuple[Design, ...]]:
    """Return all designs of the package `objects` by the class of the whole, in the order of their modules."""
    catalogue: list[Design] = []
    for module in sorted(m.name for m in pkgutil.iter_modules(objects.__path__)):
        catalogue += getattr(import_module(f"{objects.__name__}.{module}"), "DESIGNS", ())
    return {label: tuple(d for d in catalogue if d.label == label) for label in sorted({d.label for d in catalogue})}


def choose(label: str, rng: np.random.Generator, name: str | None = None) -> Design:
    """Choose a design of a class by weight, or by name."""
    known = designs()[label]
    if name is not None:
        return next(design for design in known if design.name == name)
    weights = np.cumsum([design.weight for design in known])
    return known[int(np.searchsorted(weights, rng.random() * weights[-1], side="right"))]
