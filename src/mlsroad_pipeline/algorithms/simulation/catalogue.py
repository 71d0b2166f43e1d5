"""Every design that a street can be furnished with, by class."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.simulation import furniture, poles, vegetation, vehicles
from mlsroad_pipeline.algorithms.simulation.design import Design
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, rotation_matrix

_PACKAGE = "mlsroad_pipeline.algorithms.simulation.objects"

Builder = Callable[[np.random.Generator], Mesh]


def _faced(build: Builder, rng: np.random.Generator) -> Mesh:
    """Turn a mesh whose front is along -y to one whose front is along +x."""
    return build(rng).moved([0.0, 0.0, 0.0], yaw=np.pi / 2)


def _signal(rng: np.random.Generator) -> Mesh:
    # Its arm is its front: that is where the road is.
    return _faced(poles.traffic_light, rng)


def _bollard(rng: np.random.Generator) -> Mesh:
    post = furniture.bollards(rng)[0]
    return post.moved([-float(post.vertices[:, 0].mean()), 0.0, 0.0])


def _own(name: str, label: str, build: Builder, clearance: float, weight: float = 1.0) -> Design:
    return Design(name, label, partial(_faced, build), clearance, weight)


_OWN: tuple[Design, ...] = (
    Design("broadleaf", "tree", vegetation.broadleaf_tree, 0.8),
    Design("palm", "palm", vegetation.palm, 0.7),
    Design("cycas", "cycas", vegetation.cycas, 0.8),
    Design("bush", "brushwood", vegetation.brushwood, 1.1),
    *(
        _own(f"{name}_lamp", "light_pole", partial(poles.light_pole, design=name), 0.4)
        for name in poles.LAMP_DESIGNS
    ),
    _own("post_sign", "traffic_sign", poles.traffic_sign, 0.6),
    Design("signal", "traffic_light", _signal, 0.5),
    _own("stop_sign", "station_sign", furniture.bus_stop_sign, 0.5),
    _own("shelter", "bus_shelter", furniture.bus_shelter, 2.4),
    _own("litter_bin", "bin", furniture.waste_bin, 0.5),
    _own("bench", "bench", furniture.bench, 1.2),
    _own("bollard", "bollard", _bollard, 0.3),
    _own("hydrant", "hydrant", furniture.hydrant, 0.4),
    _own("mail_box", "mail_box", furniture.mail_box, 0.4),
    *(Design(name, "car", partial(vehicles.car, design=name), 2.9) for name in vehicles.CAR_DESIGNS),
    Design("delivery_van", "van", vehicles.van, 3.4),
    Design("city_bus", "bus", vehicles.bus, 6.5),
    Design("bicycle", "bicycle", vehicles.bicycle, 0.9),
    Design("cyclist", "rider", vehicles.cyclist, 0.9),
    Design("walker", "person", vehicles.person, 0.5),
)  # fmt: skip


@cache
def designs() -> dict[str, tuple[Design, ...]]:
    """Return all designs by the class of the whole; those of the package `objects` take the place of built-in ones.

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
    try:
        package = import_module(_PACKAGE)
    except ModuleNotFoundError:
        package = None
    if package is not None:
        for module in sorted(m.name for m in pkgutil.iter_modules(package.__path__)):
            found += getattr(import_module(f"{_PACKAGE}.{module}"), "DESIGNS", ())
    covered = {design.label for design in found}
    found += [design for design in _OWN if design.label not in covered]
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


def hung_pole(rng: np.random.Generator) -> tuple[Design, Mesh, NDArray[np.float64]]:
    """Draw a utility pole and where its wires hang.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the design and of the pole.

    Returns
    -------
    design : Design
        Its design.
    pole : Mesh
        The pole; wires run along its y axis.
    points : ndarray of shape (w, 3), float64
        Where wires hang, metres.
    """
    if "utility_pole" in designs():
        design = choose("utility_pole", rng)
        mesh, points = import_module(f"{_PACKAGE}.utility_poles").hung_pole(design.name, rng)
        return design, mesh, points
    mesh, points = poles.utility_pole(rng)
    turned = points @ rotation_matrix(np.pi / 2, 0.0, 0.0).T
    return Design("line_pole", "utility_pole", _line_pole, 0.5), mesh.moved([0.0, 0.0, 0.0], yaw=np.pi / 2), turned


def _line_pole(rng: np.random.Generator) -> Mesh:
    return hung_pole(rng)[1]


def sign_plate(rng: np.random.Generator) -> tuple[Mesh, str, float]:
    """Draw the plate of a traffic sign, upright with its middle at the origin, front along +x.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of its shape, size and colours.

    Returns
    -------
    plate : Mesh
        The plate.
    name : str
        What it is called in the table of objects.
    half : float
        Half its height, metres.
    """
    try:
        plates = import_module(f"{_PACKAGE}.sign_plates")
    except ModuleNotFoundError:
        plates = None
    if plates is not None:
        plate, half = plates.sign_plate(rng)
        return plate, "plate_on_lamp", float(half)
    plate, half = poles.sign_plate(rng)
    return plate.moved([0.0, 0.0, 0.0], yaw=np.pi / 2), "plate_on_lamp", half
