"""Costs of matches (Luo et al. 2016, equations 2 to 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.papers.shared.patches.table import Patches

N_ABSOLUTE = 4
"""Columns compared by absolute differences: red, green, blue and height."""

_LEAST = np.float32(1e-30)
_LEAST_OF_TWO = np.float32(1e-15)


@dataclass(frozen=True)
class CostWeights:
    """Weights of the three costs of a match. Without colour, its weight is distributed over the other two."""

    # Weight alpha_c of the summed absolute differences of red, green and blue in [0, 1] (equation 3)
    colour: float = 0.3
    height: float = 0.3  # Weight alpha_h of the difference of heights (equation 5)
    # Weight alpha_f of the chi-square distance of the histograms (equation 4); bins empty in both contribute 0
    shape: float = 0.4
    # H_max, the height difference of cost 1, metres. Smaller values increase the influence of height.
    max_height: float = 20.0

    def __post_init__(self) -> None:
        for name in ("colour", "height", "shape"):
            if not np.isfinite(getattr(self, name)) or getattr(self, name) < 0:
                raise ParameterError(f"the weight of {name} must be a finite number >= 0, got {getattr(self, name)!r}")
        if self.height + self.shape == 0:
            raise ParameterError("the weights of height and shape must not both be 0")
        check_positive(self.max_height, "max_height")

    def without_colour(self) -> CostWeights:
        """Return the weights for patches without colour: its weight is distributed proportionally."""
        grown = (self.colour + self.height + self.shape) / (self.height + self.shape)
        return CostWeights(0.0, self.height * grown, self.shape * grown, self.max_height)


def weigh_descriptors(patches: Patches, weights: CostWeights, *, with_colour: bool) -> NDArray[np.float32]:
    """Scale descriptors so that a cost is a sum: absolute differences of four columns, chi-square of the rest."""
    if with_colour and patches.rgb is None:
        raise DataError("the patches have no colour, but the patches to match have it")
    used = weights if with_colour else weights.without_colour()
    table = np.zeros((len(patches), N_ABSOLUTE + patches.fpfh.shape[1]), np.float32)
    if with_colour and patches.rgb is not None:
        table[:, :3] = used.colour * patches.rgb
    table[:, 3] = used.height / used.max_height * patches.height
    # The chi-square distance is linear in a common factor of both histograms.
    table[:, N_ABSOLUTE:] = used.shape * patches.fpfh
    return table


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "arcp"})
def bounded_cost(a: NDArray[np.float32], i: int, b: NDArray[np.float32], j: int, bound: np.float32) -> np.float32:
    """Return the cost of matching row i of `a` with row j of `b`, or a partial cost of at least `bound`."""
    absolute = abs(a[i, 0] - b[j, 0]) + abs(a[i, 1] - b[j, 1]) + abs(a[i, 2] - b[j, 2]) + abs(a[i, 3] - b[j, 3])
    if absolute >= bound:
        return absolute
    chi_square = np.float32(0.0)
    for k in range(N_ABSOLUTE, a.shape[1]):
        difference = a[i, k] - b[j, k]
        chi_square += difference * difference / (a[i, k] + b[j, k] + _LEAST)
    return absolute + chi_square


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "arcp"})
def block_costs(a: NDArray[np.float32], i: int, block: NDArray[np.float32], n: int, costs: NDArray[np.float32]) -> None:
    """Write the costs of matching row i of `a` with the first n columns of a transposed table.

    Loops along the columns vectorise: a tenth of the time of `bounded_cost`, with differences in the last bits. Two
    bins share a division.
    """
    for j in range(n):
        absolute = abs(a[i, 0] - block[0, j]) + abs(a[i, 1] - block[1, j])
        costs[j] = absolute + abs(a[i, 2] - block[2, j]) + abs(a[i, 3] - block[3, j])
    width = a.shape[1]
    for k in range(N_ABSOLUTE, width - 1, 2):
        p, q, first, second = a[i, k], a[i, k + 1], block[k], block[k + 1]
        for j in range(n):
            d, e = p - first[j], q - second[j]
            s, t = p + first[j] + _LEAST_OF_TWO, q + second[j] + _LEAST_OF_TWO
            costs[j] += (d * d * t + e * e * s) / (s * t)
    if (width - N_ABSOLUTE) % 2:
        p, first = a[i, width - 1], block[width - 1]
        for j in range(n):
            costs[j] += (p - first[j]) * (p - first[j]) / (p + first[j] + _LEAST)
