"""Disturbances of objects: down-sampling, noise, outliers and occlusion (Luo et al. 2019, section 4.5).

Levels refer to the normalised space of the paper: x, y in [-1, 1] and z in [0, 2] for objects of any size.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_xyz


@dataclass(frozen=True)
class Disturbance:
    """Levels of disturbance; they apply in the order of the parameters."""

    # Share of the points to keep, above 0 and at most 1 (paper: down to 1/64); at least one point is kept
    keep: float = 1.0
    noise: float = 0.0  # Standard deviation of Gaussian noise on each axis in normalised space (paper: up to 0.1)
    # Share of outliers in the result, at least 0 and below 1 (equation 13; paper: up to 0.3). Outliers are uniformly
    # distributed over the normalised space.
    outliers: float = 0.0
    # Hidden share of the normalised space, at least 0 and below 1 (equation 19): a slab from one side along x or y. At
    # least one point is kept.
    occlusion: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.keep <= 1:
            raise ParameterError(f"keep must be above 0 and at most 1, got {self.keep!r}")
        if not 0 <= self.noise < np.inf:
            raise ParameterError(f"noise must be at least 0 and finite, got {self.noise!r}")
        for name in ("outliers", "occlusion"):
            if not 0 <= getattr(self, name) < 1:
                raise ParameterError(f"{name} must be at least 0 and below 1, got {getattr(self, name)!r}")


PAPER_LEVELS = (
    Disturbance(keep=0.5, noise=0.01, outliers=0.1),
    Disturbance(keep=0.5, noise=0.03, outliers=0.2),
    Disturbance(keep=0.5, noise=0.05, outliers=0.3),
)
"""Test sets 1, 2 and 3 of Luo et al. 2019, section 4.2."""


def down_sample(xyz: ArrayLike, share: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return a random subset of the points."""
    n = len(np.asarray(xyz))
    return np.sort(rng.choice(n, max(round(share * n), 1), replace=False))


def add_noise(xyz: ArrayLike, deviation: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Add Gaussian noise to each point."""
    points = check_xyz(xyz, minimum=1).astype(np.float64)
    return points + rng.normal(size=points.shape) * deviation * 0.5 * np.ptp(points, axis=0)


def draw_outliers(xyz: ArrayLike, rate: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return outliers, uniformly distributed over the bounding box of an object."""
    points = check_xyz(xyz, minimum=1).astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    return low + rng.uniform(size=(round(len(points) * rate / (1 - rate)), 3)) * (high - low)


def occlude(xyz: ArrayLike, rate: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the points outside a hidden slab of the bounding box of an object.

    The paper hides a share of the extent along one horizontal axis over the full width and height (equation 19); the
    position is not specified. Here the slab is at one end of the x or y axis, each of the four with equal probability.
    """
    points = check_xyz(xyz, minimum=1).astype(np.float64)
    axis, end = rng.integers(2), rng.choice([-1.0, 1.0])
    along = end * points[:, axis]
    hidden = (along.max() - along) < rate * (along.max() - along.min())
    return np.flatnonzero(~hidden) if not hidden.all() else np.array([int(along.argmin())])


def disturb(
    xyz: ArrayLike, disturbance: Disturbance, *, seed: int, intensity: ArrayLike | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Disturb an object."""
    rng = np.random.default_rng(seed)
    points = check_xyz(xyz, minimum=1).astype(np.float64)
    values = None if intensity is None else np.asarray(intensity, dtype=np.float64)
    rows = down_sample(points, disturbance.keep, rng)
    points = add_noise(points[rows], disturbance.noise, rng)
    far = draw_outliers(points, disturbance.outliers, rng)
    sources = np.concatenate([np.arange(len(points)), rng.integers(len(points), size=len(far))])
    points = np.concatenate([points, far])
    seen = occlude(points, disturbance.occlusion, rng)
    return points[seen], None if values is None else values[rows][sources][seen]
