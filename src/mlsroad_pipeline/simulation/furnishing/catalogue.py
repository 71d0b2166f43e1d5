"""Every design that a street can be furnished with, by class."""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation import objects
from mlsroad_pipeline.simulation.model.design import Design
from mlsroad_pipeline.simulation.model.meshes import Mesh


@cache
def designs() -> dict[str, tuple[Design, ...]]:
    """Return all designs of the package `objects` by the class of the whole.

    Returns
    -------
    dict of str to tuple of Design
        Classes in alphabetical order, designs in the order of their modules.

    Raises
    ------
    ParameterError
        If two designs have one name.
    """
    found: list[Design] = []
    for module in sorted(m.name for m in pkgutil.iter_modules(objects.__path__)):
        found += getattr(import_module(f"{objects.__name__}.{module}"), "DESIGNS", ())
    names = [design.name for design in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ParameterError(f"designs with one name: {', '.join(twice)}")
    return {label: tuple(d for d in found if d.label == label) for label in sorted({d.label for d in found})}


def choose(label: str, rng: np.random.Generator, name: str | None = None) -> Design:
    """Choose a design of a class by weight, or by name.

    Parameters
    ----------
    label : str
        Taxonomy class.
    rng : numpy.random.Generator
        Source of the choice; not used where a name is given.
    name : str, optional
        Name of a design of the class.

    Returns
    -------
    Design
        The design.

    Raises
    ------
    ParameterError
        If the class has no design, or none of that name.
    """
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
    """Draw an object of a class.

    Parameters
    ----------
    label : str
        Taxonomy class.
    rng : numpy.random.Generator
        Source of the design, where no name is given, and of the object.
    name : str, optional
        Name of a design of the class.

    Returns
    -------
    Mesh
        As `Design.build` gives it: foot at the origin, front along +x, metres.

    Raises
    ------
    ParameterError
        If the class has no design, or none of that name.
    """
    return choose(label, rng, name).build(rng)
