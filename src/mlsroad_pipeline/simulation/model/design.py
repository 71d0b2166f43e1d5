"""Designs of street objects: recipes that build another object for every random stream."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.simulation.model.meshes import Mesh


@dataclass(frozen=True)
class Design:
    """One way to build an object of a class."""

    name: str  # Name, unique among all designs, such as ``"double_arm_lamp"``
    label: str  # Taxonomy class of the whole; faces may have finer ones
    # From a random generator to a mesh in metres that stands on z = 0 with its foot at the origin, front or arm along
    # +x. Equal streams give equal meshes; no two streams give the same.
    build: Callable[[np.random.Generator], Mesh]
    clearance: float  # Half of the length along the street that it keeps free, metres
    weight: float = 1.0  # Relative frequency among the designs of its class

    def __post_init__(self) -> None:
        if self.label not in TAXONOMY:
            raise ParameterError(f"design {self.name!r}: {self.label!r} is not in the taxonomy")
        check_positive(self.clearance, "clearance")
        check_positive(self.weight, "weight")
