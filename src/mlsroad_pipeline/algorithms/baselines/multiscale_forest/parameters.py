"""Parameters of the multiscale forest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least
from mlsroad_pipeline.algorithms.features.sphere_features import check_spheres

SLUG = "multiscale_forest"


@dataclass(frozen=True)
class MultiscaleForestParameters:
    """Parameters of the multiscale forest.

    Parameters
    ----------
    radius : float, default 0.1
        Radius of the smallest spheres, metres (thomas2018: 0.1).
    n_scales : int, default 8
        Number of scales; the largest radius is 12.8 m with the other defaults (thomas2018: 8).
    ratio : float, default 2.0
        Ratio of the radii of successive scales (thomas2018: 2).
    points_per_radius : float, default 5.0
        Ratio of radius and cell of the subsampling (thomas2018: 5). Points of one finest cell get one class.
    n_trees : int, default 100
        Trees; training and prediction time grow with them.
    min_samples_leaf : int, default 3
        Minimum voxels of a leaf. Larger values give smoother probabilities and a smaller model.
    max_features : float, default 0.08
        Share of the features tried at each split; training time grows with it.
    max_per_scene : int, default 1000
        Maximum training voxels of a class in a scene.
    max_per_class : int, default 3000
        Maximum training voxels of a class; bounds the training time.
    dropout : float, default 0.3
        Share of the training voxels whose intensity is hidden, and whose colour is hidden; models then label surveys
        without them.
    seed : int, default 2018
        Seed of samples, dropout and forest.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    radius: float = 0.1
    n_scales: int = 8
    ratio: float = 2.0
    points_per_radius: float = 5.0
    n_trees: int = 100
    min_samples_leaf: int = 3
    max_features: float = 0.08
    max_per_scene: int = 1000
    max_per_class: int = 3000
    dropout: float = 0.3
    seed: int = 2018

    def __post_init__(self) -> None:
        check_spheres(**self.spheres(), prefix=f"{SLUG}.")
        for name in ("n_trees", "min_samples_leaf", "max_per_scene", "max_per_class"):
            check_at_least(getattr(self, name), 1, f"{SLUG}.{name}")
        if not 0 < self.max_features <= 1:
            raise ParameterError(f"{SLUG}.max_features must be in (0, 1], got {self.max_features!r}")
        if not 0 <= self.dropout < 1:
            raise ParameterError(f"{SLUG}.dropout must be in [0, 1), got {self.dropout!r}")

    def spheres(self) -> dict[str, Any]:
        """Return the parameters of the neighbourhoods, as keywords of `find_spheres`."""
        return {name: getattr(self, name) for name in ("radius", "n_scales", "ratio", "points_per_radius")}
