"""Whether a scene is like those that a model was trained on, from facts of its shape.

The class probabilities of a model do not tell: trees and network are sure of their classes on a scene that is upside
down. A classifier is therefore trained on the facts of training scenes and of changed copies of them, such as copies
without the ground or in feet (outlier exposure, Hendrycks et al. 2019). The facts are those of `scene_facts`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.labeller import softmax
from mlsroad_pipeline.algorithms.models.boosted_trees.parameters import BoostedTreesParameters
from mlsroad_pipeline.algorithms.models.boosted_trees.training import train_trees
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, arrays_under
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees
from mlsroad_pipeline.algorithms.quality.scene_facts import scene_facts
from mlsroad_pipeline.algorithms.stages import find_ground, inliers

FAMILIAR = "familiar"

KINDS = {
    FAMILIAR: "like the training data",
    "no ground": "it has no ground: heights and all classes near the ground are wrong without it",
    "low": "it ends little above the ground: the heights of objects are missing",
    "no lower part": "the lowest metres are missing",
    "scale": "its unit may not be the metre: set label.read.units",
    "squeezed": "heights and distances do not fit each other: check the unit of the heights",
    "turned": "its third coordinate may not be the height, or points down",
    "from above": "it shows surfaces from above, as an airborne scan does: sides of objects are missing",
    "indoors": "it may be indoors",
    "thinned": "its points are evenly thinned: small objects are lost",
    "noisy": "its surfaces are blurred: poses or ranges have errors of decimetres",
}
"""Kinds of scenes, and what a warning says of each."""

FACTS = (
    "density", "concentration", "spacing", "even", "height", "median_height", "above_2", "above_5", "ground", "low",
    "step", "large_step", "floor", "linear", "planar", "scattered", "level", "upright",
)  # fmt: skip
"""Facts that the classifier takes; no intensity."""

ARRAYS, METADATA = "familiarity", "familiarity"
"""Prefix of the arrays of the classifier in a model, and key of its kinds in the metadata."""

_FEWEST = 300
_PARAMETERS = BoostedTreesParameters(
    rounds=60,
    leaves=8,
    learning_rate=0.1,
    min_child_samples=10,
    feature_fraction=0.5,
    lambda_l2=3.0,
    checkpoint_rounds=60,
)
_LEAST_TRUST, _GAIN = 0.4, 1.2
"""Factor of the confidence on a scene that is surely unlike the training data, and its rise with the probability of a
familiar one: the factor is 1 from 0.5 upward."""

_STEEPEST = 0.15
"""Largest grade of a copy; the mean is a third of it. Simulated streets are mostly level, recorded ones are not."""

Change = Callable[[PointCloud, NDArray[np.float32]], PointCloud]


def _moved(scene: PointCloud, xyz: NDArray) -> PointCloud:
    return PointCloud(np.ascontiguousarray(xyz, dtype=scene.xyz.dtype))


def _sloped(scene: PointCloud, rng: np.random.Generator) -> PointCloud:
    """Return a scene whose heights rise in one direction, as on a hill."""
    grade, azimuth = _STEEPEST * rng.random() ** 2, 2 * np.pi * rng.random()
    rise = grade * (scene.xyz[:, 0] * np.cos(azimuth) + scene.xyz[:, 1] * np.sin(azimuth))
    return _moved(scene, scene.xyz + rise[:, None] * [0.0, 0.0, 1.0])


def _first_of_cells(scene: PointCloud, edge: float, axes: int) -> PointCloud:
    """Return one point of each cell, the highest one of columns (two axes)."""
    order = np.argsort(-scene.xyz[:, 2], kind="stable") if axes == 2 else np.arange(len(scene))
    cells = np.floor(scene.xyz[order, :axes] / edge).astype(np.int64)
    return scene.select(np.sort(order[np.unique(cells, axis=0, return_index=True)[1]]))


def _kept(scene: PointCloud, keep: NDArray[np.bool_]) -> PointCloud:
    return scene.select(np.flatnonzero(keep))


def changes(rng: np.random.Generator) -> list[tuple[str, Change]]:
    """Return changes of scenes and the kind of what they give, with random sizes."""
    draw = rng.uniform
    down = np.array([1.0, 1.0, -1.0])
    return [
        (FAMILIAR, lambda scene, _: scene),
        (FAMILIAR, lambda scene, _: scene),
        (FAMILIAR, lambda scene, _: _kept(scene, rng.random(len(scene)) < draw(0.3, 0.9))),
        (FAMILIAR, lambda scene, _: _kept(scene, rng.random(len(scene)) < draw(0.3, 0.9))),
        ("no ground", lambda scene, height: _kept(scene, height > draw(0.1, 0.5))),
        ("low", lambda scene, height: _kept(scene, height < draw(0.8, 1.4))),
        ("low", lambda scene, height: _kept(scene, height < draw(0.1, 0.3))),
        ("no lower part", lambda scene, height: _kept(scene, height > draw(1.5, 3.0))),
        ("scale", lambda scene, _: _moved(scene, scene.xyz / 0.3048)),
        ("scale", lambda scene, _: _moved(scene, scene.xyz * 0.3048)),
        ("scale", lambda scene, _: _moved(scene, scene.xyz * 10.0 ** rng.choice([-2.0, -1.0, 1.0]))),
        ("squeezed", lambda scene, _: _moved(scene, scene.xyz * [1.0, 1.0, draw(0.2, 0.4)])),
        ("squeezed", lambda scene, _: _moved(scene, scene.xyz * [1.0, 1.0, draw(2.5, 4.0)])),
        ("turned", lambda scene, _: _moved(scene, scene.xyz[:, [0, 2, 1]])),
        ("turned", lambda scene, _: _moved(scene, scene.xyz * down)),
        ("from above", lambda scene, _: _first_of_cells(scene, draw(0.25, 0.8), 2)),
        ("thinned", lambda scene, _: _first_of_cells(scene, draw(0.08, 0.35), 3)),
        ("noisy", lambda scene, _: _moved(scene, scene.xyz + rng.normal(0.0, draw(0.15, 0.6), scene.xyz.shape))),
        ("noisy", lambda scene, _: _moved(scene, rng.random(scene.xyz.shape) * [40.0, 40.0, draw(5.0, 20.0)])),
        ("indoors", lambda scene, _: simulated_rooms(rng)),
    ]


def simulated_rooms(rng: np.random.Generator) -> PointCloud:
    """Return points on the insides of a few furnished rooms in a row."""
    points, start, density = [], 0.0, rng.uniform(50.0, 2000.0)
    for _ in range(rng.integers(1, 5)):
        size = np.array([rng.uniform(3.0, 15.0), rng.uniform(3.0, 10.0), rng.uniform(2.3, 4.0)])
        boxes = [(np.zeros(3), size)]
        for _ in range(rng.integers(0, 8)):
            box = rng.uniform([0.3, 0.3, 0.4], [2.0, 1.0, 2.0])
            boxes.append((np.append(rng.uniform(0.0, 1.0, 2) * np.maximum(size[:2] - box[:2], 0.0), 0.0), box))
        points += [_sides(corner + np.array([start, 0.0, 0.0]), box, density, rng) for corner, box in boxes]
        start += size[0] + 0.15
    xyz = np.concatenate(points)
    return PointCloud(xyz + rng.normal(0.0, rng.uniform(0.002, 0.02), xyz.shape))


def _sides(
    corner: NDArray[np.float64], size: NDArray[np.float64], density: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return random points on the six sides of a box."""
    parts = []
    for axis in range(3):
        area = np.prod(np.delete(size, axis))
        xyz = rng.random((2 * int(density * area) + 2, 3))
        xyz[:, axis] = np.round(xyz[:, axis])
        parts.append(corner + xyz * size)
    return np.concatenate(parts)


def facts_of_changes(scene: PointCloud, ground: GroundParameters, *, seed: int) -> dict[str, NDArray]:
    """Return the facts of a training scene and of changed copies of it, and the number of the kind of each.

    Half of the copies are of a part of the scene, since surveys are cut in many ways. All are sloped.
    """
    rng = np.random.default_rng([seed, len(scene)])
    scene = PointCloud(scene.xyz[inliers(scene)])
    values, kinds = [], []
    if len(scene):
        height = find_ground(scene, ground)["height"]
        for kind, change in changes(rng):
            rows = np.arange(len(scene))
            if rng.random() < 0.5:
                offset = np.abs(scene.xyz[:, :2] - scene.xyz[rng.integers(len(scene)), :2]).max(axis=1)
                rows = np.flatnonzero(offset < rng.uniform(15.0, 30.0))
            changed = change(_sloped(scene.select(rows), rng), height[rows])
            if len(changed) >= _FEWEST:
                values.append(facts_vector(scene_facts(changed)))
                kinds.append(list(KINDS).index(kind))
    return {"values": np.array(values, np.float32).reshape(-1, len(FACTS)), "kinds": np.array(kinds, np.int16)}


def facts_vector(facts: Mapping[str, float]) -> NDArray[np.float32]:
    """Return the facts in the order of `FACTS`; NaN for a missing one."""
    return np.array([facts.get(name, np.nan) for name in FACTS], np.float32)


def with_familiarity(
    bundle: ModelBundle, tables: Sequence[Mapping[str, NDArray]], sources: Sequence[str]
) -> ModelBundle:
    """Return a model with a classifier of scenes; each source, and familiar scenes and others, have equal weights."""
    kinds = np.concatenate([table["kinds"] for table in tables])
    source = np.repeat(np.unique(np.asarray(sources), return_inverse=True)[1], [len(t["kinds"]) for t in tables])
    weight = 1.0 / np.bincount(source)[source]
    usual = kinds == list(KINDS).index(FAMILIAR)
    weight = np.where(usual, weight / weight[usual].sum(), weight / weight[~usual].sum())
    allowed = kinds[:, None] == np.arange(len(KINDS))
    trees = train_trees(
        np.concatenate([table["values"] for table in tables]),
        allowed,
        weight * (len(kinds) / 2),
        parameters=_PARAMETERS,
    )
    arrays = {f"{ARRAYS}/{name}": values for name, values in trees.to_arrays().items()}
    metadata = {**bundle.metadata, METADATA: {"kinds": list(KINDS), "facts": list(FACTS)}}
    return replace(bundle, arrays={**bundle.arrays, **arrays}, metadata=metadata)


def familiarity_of(source: ModelBundle, target: ModelBundle) -> ModelBundle:
    """Return a model with the classifier of another one, if that has one."""
    if METADATA not in source.metadata:
        return target
    arrays = {name: values for name, values in source.arrays.items() if name.startswith(f"{ARRAYS}/")}
    metadata = {**target.metadata, METADATA: source.metadata[METADATA]}
    return replace(target, arrays={**target.arrays, **arrays}, metadata=metadata)


def kind_probabilities(bundle: ModelBundle, scene: PointCloud) -> NDArray[np.float64] | None:
    """Return the probabilities of `KINDS` for a scene; None for a model without the classifier, or for few points."""
    stored = bundle.metadata.get(METADATA)
    if stored is None:
        return None
    if stored != {"kinds": list(KINDS), "facts": list(FACTS)}:
        raise DataError(f"model {bundle.slug!r} describes scenes by other facts than this version: train it again")
    facts = scene_facts(scene)
    if not facts:
        return None
    if ARRAYS not in bundle.prepared:
        bundle.prepared[ARRAYS] = BoostedTrees.from_arrays(arrays_under(bundle.arrays, f"{ARRAYS}/"))
    trees: BoostedTrees = bundle.prepared[ARRAYS]
    return softmax(trees.scores(facts_vector(facts)[None]).astype(np.float64))[0]


def trust(probabilities: NDArray[np.float64] | None) -> float:
    """Return the factor of the confidences of a scene, from 0.4 for a strange one to 1 from an even chance upward."""
    if probabilities is None:
        return 1.0
    return float(min(1.0, _LEAST_TRUST + _GAIN * probabilities[list(KINDS).index(FAMILIAR)]))
