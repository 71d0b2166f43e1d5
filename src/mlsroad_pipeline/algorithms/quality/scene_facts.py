"""Facts of a scene that a labeller depends on (density, spacing, heights, shapes), against those of training data."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.quality.density import density_figures

REACH = 250.0
"""Points farther than this from the median of the points along an axis are left out, metres."""

_GROUND_STEP, _GROUND_HEIGHT = 0.3, 1.0
_CELLS_AROUND = 11
_SAMPLE, _HEIGHTS = 20_000, 200_000
_PER_CELL, _CELLS, _QUERIES, _NEIGHBOURS = 30, 80, 1_000, 20
_LEVEL, _UPRIGHT = 0.9, 0.2
"""Vertical component of the normal above which a plane is level, and below which it is upright."""

_FEWEST = 100
"""Fewest points of a scene with facts."""


def scene_facts(cloud: PointCloud) -> dict[str, float]:
    """Return facts of a scene.

    Heights are above the lowest point within about 5 m. Heights, spacing, shapes and intensities come from samples at
    equal steps of the stored order, so they depend on it slightly.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(0, 20, 0.1), np.arange(0, 20, 0.1))
    >>> plane = PointCloud(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]))
    >>> facts = scene_facts(plane)
    >>> round(facts["density"]), round(facts["spacing"], 2), facts["ground"], facts["planar"]
    (100, 0.1, 1.0, 1.0)
    """
    xyz = np.asarray(cloud.xyz)
    if not np.isfinite(xyz.sum(dtype=np.float64)):
        xyz = xyz[np.isfinite(xyz).all(axis=1)]
    if len(xyz) < _FEWEST:
        return {}
    middle = np.median(xyz[:: _step(len(xyz), _SAMPLE)], axis=0)
    x, y = (xyz[:, axis] - (middle[axis] - REACH) for axis in range(2))
    inside = (x > 0) & (x < 2 * REACH) & (y > 0) & (y < 2 * REACH)
    if not inside.all():
        xyz, x, y = xyz[inside], x[inside], y[inside]
    if len(xyz) < _FEWEST:
        return {}
    side = int(2 * REACH)
    shape = side, side
    key = x.astype(np.int32) * np.int32(side) + y.astype(np.int32)
    counts = np.bincount(key, minlength=side * side).astype(np.int64)
    step = _step(len(xyz), _HEIGHTS)
    facts = _density_facts(counts, shape) | _height_facts(xyz[::step, 2], key[::step], shape)
    facts |= _shape_facts(xyz, x, y, facts["density"])
    intensity = cloud.get("intensity")
    if intensity is not None:
        sample = intensity[:: _step(len(intensity), _SAMPLE)]
        facts["intensities"] = float(len(np.unique(sample[np.isfinite(sample)])))
    return {name: value for name, value in facts.items() if np.isfinite(value)}


def stored_facts(cloud: PointCloud) -> dict[str, NDArray[np.float64]]:
    """Return `scene_facts` as arrays, for storage."""
    return {name: np.array(value) for name, value in scene_facts(cloud).items()}


def _step(n: int, most: int) -> int:
    return max(1, -(-n // most))


def _density_facts(counts: NDArray[np.int64], shape: tuple[int, int]) -> dict[str, float]:
    occupied = np.flatnonzero(counts).astype(np.int64)
    keys = (occupied // shape[1] << 32) + occupied % shape[1]
    figures = density_figures(keys, counts[occupied], 1.0)
    return {"density": figures.median_density, "concentration": figures.concentration}


def _height_facts(z: NDArray[np.floating], key: NDArray[np.integer], shape: tuple[int, int]) -> dict[str, float]:
    lowest = np.full(shape[0] * shape[1], np.inf)
    np.minimum.at(lowest, key, z.astype(np.float64))
    around = minimum_filter(lowest.reshape(shape), size=_CELLS_AROUND, mode="constant", cval=np.inf).ravel()
    height, step = z - around[key], z - lowest[key]
    return {
        "height": float(np.quantile(height[:: _step(len(z), _SAMPLE)], 0.99)),
        "above_2": float(np.mean(height > 2)),
        "above_5": float(np.mean(height > 5)),
        "ground": float(np.mean((step < _GROUND_STEP) & (height <= _GROUND_HEIGHT))),
        "median_height": float(np.median(height)),
        "low": float(np.mean(height < _GROUND_STEP)),
        **_floor_facts(lowest.reshape(shape), around.reshape(shape)),
    }


def _floor_facts(lowest: NDArray[np.float64], around: NDArray[np.float64]) -> dict[str, float]:
    """Return steps between the lowest points of neighbouring cells, and the share of cells that reach the floor."""
    occupied = np.isfinite(lowest)
    found = []
    for grid, filled in ((lowest, occupied), (lowest.T, occupied.T)):
        both = filled[1:] & filled[:-1]
        found.append(np.abs(grid[1:][both] - grid[:-1][both]))
    steps = np.concatenate(found)
    if not len(steps):
        return {}
    middle, upper = np.quantile(steps, (0.5, 0.75)).tolist()
    return {
        "step": middle,
        "large_step": upper,
        "floor": float(np.mean(lowest[occupied] - around[occupied] < _GROUND_STEP)),
    }


def _shape_facts(
    xyz: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating], density: float
) -> dict[str, float]:
    """Return spacing and shapes at points of some small cells, with all points of the cells around these."""
    edge = float(np.clip(np.sqrt(_PER_CELL / density), 0.25, 2.0))
    side = int(2 * REACH / edge) + 3
    key = ((x / edge).astype(np.int32) + 1) * np.int32(side) + (y / edge).astype(np.int32) + 1
    centres = np.unique(key[:: _step(len(key), _CELLS)])
    near = np.zeros(side * side, dtype=np.bool_)
    near[(centres[:, None] + [dx * side + dy for dx in (-1, 0, 1) for dy in (-1, 0, 1)]).ravel()] = True
    picked = np.flatnonzero(near[key])
    points = xyz[picked].astype(np.float64)
    queries = points[np.isin(key[picked], centres)]
    queries = queries[:: _step(len(queries), _QUERIES)]
    k = min(_NEIGHBOURS, len(points) - 1)
    if k < 3:
        return {}
    distance, index = cKDTree(points, balanced_tree=False, compact_nodes=False).query(queries, k + 1)
    around = points[index]
    around -= around.mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    spread = np.sqrt(np.maximum(variances, 0))[:, ::-1]
    kinds = np.column_stack([spread[:, 0] - spread[:, 1], spread[:, 1] - spread[:, 2], spread[:, 2]]).argmax(axis=1)
    shares = np.bincount(kinds, minlength=3) / len(kinds)
    linear, planar, scattered = shares.tolist()
    near, spacing, far = np.quantile(distance[:, 1], (0.25, 0.5, 0.75)).tolist()
    slope, is_plane = np.abs(axes[:, 2, 0]), kinds == 1
    return {
        "spacing": spacing, "linear": linear, "planar": planar, "scattered": scattered,
        "level": float(np.mean(is_plane & (slope > _LEVEL))),
        "upright": float(np.mean(is_plane & (slope < _UPRIGHT))),
        "even": near / far if far > 0 else 1.0,
    }  # fmt: skip


QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
"""Quantiles of a fact over the training scenes. The ends are extremes: a few dense streets among many scans count."""

TrainingFacts = Mapping[str, Sequence[float]]


class _Fact(NamedTuple):
    """Words about a fact: text before and after its value, unit, and whether it is a share or compares by its ratio."""

    before: str
    after: str = ""
    unit: str = ""
    share: bool = False
    ratio: bool = False


_FACTS = {
    "density": _Fact("the median density is", unit=" points per m²", ratio=True),
    "spacing": _Fact("points lie", " apart (median)", " m", ratio=True),
    "height": _Fact("the highest points (99 % quantile) are", " above the lowest around them", " m", ratio=True),
    "above_2": _Fact("", " of the points are more than 2 m high", share=True),
    "above_5": _Fact("", " of the points are more than 5 m high", share=True),
    "ground": _Fact("", " of the points are close to the ground", share=True),
    "concentration": _Fact("the concentration about one place is"),
    "intensities": _Fact("the intensity has", " distinct values", ratio=True),
    "linear": _Fact("", " of the neighbourhoods are linear", share=True),
    "planar": _Fact("", " of the neighbourhoods are planar", share=True),
    "scattered": _Fact("", " of the neighbourhoods are scattered", share=True),
}
_SHARE_MARGIN, _RATIO_MARGIN, _MARGIN = 0.03, 1.25, 0.05
_LEAST = 1e-3


def training_facts(scenes: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Return the range of each fact over the training scenes.

    Examples
    --------
    >>> training_facts([{"spacing": 0.02}, {"spacing": 0.04}, {"spacing": 0.06}])
    {'spacing': [0.02, 0.022, 0.04, 0.058, 0.06]}
    """
    found = {name: [scene[name] for scene in scenes if name in scene] for name in _FACTS}
    return {
        name: [float(f"{value:.4g}") for value in np.quantile(values, QUANTILES).tolist()]
        for name, values in found.items()
        if values
    }


def median_facts(scenes: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the median of each fact over scenes of a survey."""
    names = [name for name in _FACTS if any(name in scene for scene in scenes)]
    return {name: float(np.median([scene[name] for scene in scenes if name in scene])) for name in names}


def unusual_facts(facts: Mapping[str, float], training: TrainingFacts) -> list[str]:
    """Return one sentence per fact that is outside the range of the training scenes.

    The range is that between the least and the largest value, widened by 0.03 (shares), 0.05 (concentration) or a
    quarter of the value (others).

    Examples
    --------
    >>> unusual_facts({"spacing": 0.9}, {"spacing": [0.02, 0.03, 0.1, 0.4, 0.5]})
    ['points lie 0.9 m apart (median; training scenes 0.02 to 0.5 m)']
    """
    sentences = []
    for name, fact in _FACTS.items():
        if name in facts and name in training:
            low, *_, high = _range(name, training)
            if not _lowest(low, fact) <= facts[name] <= _highest(high, fact):
                sentences.append(_sentence(fact, facts[name], low, high))
    return sentences


def _range(name: str, training: TrainingFacts) -> Sequence[float]:
    if len(training[name]) != len(QUANTILES):
        raise DataError(f"training_facts of {name!r} must have {len(QUANTILES)} quantiles, got {training[name]!r}")
    return training[name]


def _least_width(fact: _Fact) -> float:
    return float(np.log(_RATIO_MARGIN)) if fact.ratio else _SHARE_MARGIN if fact.share else _MARGIN


def _lowest(low: float, fact: _Fact) -> float:
    return low / _RATIO_MARGIN if fact.ratio else low - _least_width(fact)


def _highest(high: float, fact: _Fact) -> float:
    return high * _RATIO_MARGIN if fact.ratio else high + _least_width(fact)


def _sentence(fact: _Fact, value: float, low: float, high: float) -> str:
    def text(number: float) -> str:
        return f"{100 * number:.0f}" if fact.share else f"{number:.3g}" if number < 1000 else f"{number:,.0f}"

    unit = " %" if fact.share else fact.unit
    training = f"training scenes {text(low)} to {text(high)}{unit}"
    after = f"{fact.after[:-1]}; {training})" if fact.after.endswith(")") else f"{fact.after} ({training})"
    return f"{fact.before} {text(value)}{unit}{after}".strip()
