"""Growth habits of trees, and the outline of one crown."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.model.batches import Floats

Range = tuple[float, float]


@dataclass(frozen=True)
class Habit:
    """Growth habit of a kind of tree; individuals are drawn from the range of each pair."""

    height: Range  # Height of the tree, metres
    width: Range  # Diameter of the crown over the height
    clear: Range  # Height below which no limb starts, over the height
    # Exponents a and b of the outline t**a * (1 - t)**b, where t runs from the crown's foot to its top: equal ones give
    # an egg, a larger a puts the widest place higher
    profile: Range
    leader: Range  # Height of the stem's top within the crown, 0 to 1
    rise: Range  # Elevation of limbs at the stem, radians
    # Diameter of the crown over that of the stem at breast height; some 18 to 26 in open-grown street trees
    girth: Range
    limbs: tuple[int, int]  # Number of limbs
    droop: Range  # Drop of the last twigs, metres
    density: Range  # Leaf area per volume of the crown, 1/m; 0.5 to 1.2 in street trees. 0 is a bare tree.
    clump: Range  # Radius of the leaves about the twigs, metres
    stems: tuple[int, int] = (1, 1)  # Number of stems
    shell: float = 2.0  # 0 fills the crown evenly with twigs; larger values crowd them to its outside
    slenderness: float = 0.75  # Width of a leaf over its length

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple) and field.name != "profile" and value[0] > value[1]:
                raise ParameterError(f"{field.name} runs from {value[0]} down to {value[1]}")


class Outline:
    """Irregular outline of one crown."""

    def __init__(self, rng: np.random.Generator, foot: float, top: float, radius: float, profile: Range) -> None:
        self.foot, self.top = foot, top
        a, b = np.array(profile) * np.exp(rng.normal(0, 0.12, 2))
        t = np.linspace(0.0, 1.0, 41)
        shape = t**a * (1 - t) ** b
        self._t, self._radius = t, radius * shape / shape.max()
        share = np.cumsum(shape**1.5 + 5e-3)
        self._share = (share - share[0]) / (share[-1] - share[0])
        self._lobes = rng.normal(0, [0.10, 0.08, 0.07])
        self._phase, self._twist = rng.uniform(0, 2 * np.pi, 3), rng.normal(0, 3.0, 3)
        self.volume = float(np.pi * (self._radius**2).mean() * (top - foot))

    def place(self, share: Floats, azimuth: Floats, depth: Floats) -> Floats:
        """Return places in the crown, (n, 3) metres about its axis, a little denser where it is narrow.

        `share` is the share of the crown below a place, `azimuth` its direction in radians, `depth` 0 on the axis and 1
        on the outline.
        """
        t = np.interp(share, self._share, self._t)
        wave = np.cos(np.arange(1, 4) * azimuth[:, None] + self._twist * t[:, None] + self._phase) @ self._lobes
        r = np.interp(t, self._t, self._radius) * (1 + wave) * depth
        return np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), self.foot + t * (self.top - self.foot)])
