"""Facts of a scene against closed forms, and their comparison with those of training scenes."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.quality.scene_facts import (
    median_facts,
    scene_facts,
    training_facts,
    unusual_facts,
)

SPACING = [0.02, 0.03, 0.1, 0.4, 0.5]


def grid(step, x, y, z=(0.0, 0.0)):
    """Return a grid of a rectangle that is vertical if it has a height."""
    axes = [np.arange(*span, step) if span[1] > span[0] else np.array([span[0]]) for span in (x, y, z)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def test_plane_of_ground_and_a_wall_of_8_m():
    ground, wall = grid(0.1, (0, 20), (0, 20)), grid(0.1, (0, 20), (10, 10), (0.4, 8))
    facts = scene_facts(PointCloud(np.concatenate([ground, wall])))
    n = len(ground) + len(wall)
    assert facts["density"] == 100 and facts["spacing"] == pytest.approx(0.1)
    assert facts["above_2"] == pytest.approx(np.sum(wall[:, 2] > 2) / n)
    assert facts["above_5"] == pytest.approx(np.sum(wall[:, 2] > 5) / n)
    assert facts["ground"] == pytest.approx(len(ground) / n)
    assert facts["height"] == pytest.approx(np.quantile(np.r_[0 * ground[:, 2], wall[:, 2]], 0.99), abs=0.2)
    assert facts["planar"] > 0.9
    assert "intensities" not in facts


def test_levels_walls_steps_and_floor_of_a_terrace():
    lower, upper = grid(0.1, (0, 20), (0, 10)), grid(0.1, (0, 20), (10, 20)) + (0, 0, 1.5)
    facts = scene_facts(PointCloud(np.concatenate([lower, upper])))
    assert facts["level"] > 0.9 and facts["upright"] == 0 and facts["even"] == pytest.approx(1.0)
    assert facts["step"] == 0 and facts["large_step"] == 0
    # Five or six rows of cells of the upper half lie within five cells of the lower one.
    assert 1 - 6 / 20 <= facts["low"] <= 1 - 5 / 20 and facts["floor"] == pytest.approx(facts["low"], abs=0.06)
    assert facts["median_height"] == 0
    wall = scene_facts(PointCloud(grid(0.1, (0, 20), (5, 5), (0, 8))))
    assert wall["upright"] > 0.9 and wall["level"] == 0


def test_shapes_of_wires_and_of_clouds_of_points(rng):
    wires = np.concatenate([grid(0.02, (0, 40), (y, y)) for y in range(0, 40, 3)])
    assert scene_facts(PointCloud(wires))["linear"] > 0.99
    crown = rng.uniform(0, 6, (40_000, 3))
    assert scene_facts(PointCloud(crown))["scattered"] > 0.9


def test_place_and_far_points_do_not_matter(rng):
    xyz = rng.uniform(0, 15, (20_000, 3)) * (1, 1, 0.1)
    facts = scene_facts(PointCloud(xyz))
    moved = scene_facts(PointCloud(np.concatenate([xyz + (512.0, 1024.0, 64.0), [[1e7, 0, 0], [0, np.nan, 0]]])))
    assert moved == pytest.approx(facts, rel=0.02, abs=0.02)


def test_distinct_intensities_and_input_unchanged(rng):
    xyz, intensity = rng.uniform(0, 9, (5000, 3)), (np.arange(5000) % 7 / 7).astype(np.float32)
    before = xyz.copy()
    assert scene_facts(PointCloud(xyz, {"intensity": intensity}))["intensities"] == 7
    np.testing.assert_array_equal(xyz, before)


@pytest.mark.parametrize("n", [0, 1, 99])
def test_few_points_have_no_facts(n):
    assert scene_facts(PointCloud(np.zeros((n, 3)))) == {}


def test_points_in_one_place_have_finite_facts():
    facts = scene_facts(PointCloud(np.zeros((500, 3))))
    assert facts["spacing"] == 0 and facts["ground"] == 1 and np.isfinite(list(facts.values())).all()


def test_ranges_are_quantiles_of_the_scenes_that_have_the_fact():
    scenes = [{"above_2": k / 100} for k in range(101)] + [{"density": 30.0}]
    found = training_facts(scenes)
    assert found["above_2"] == pytest.approx([0.0, 0.05, 0.5, 0.95, 1.0]) and found["density"] == [30.0] * 5
    assert training_facts([]) == {}
    assert median_facts(scenes) == {"density": 30.0, "above_2": 0.5}


@pytest.mark.parametrize(
    ("name", "value", "span", "sentence"),
    [
        ("spacing", 0.9, SPACING, "points lie 0.9 m apart (median; training scenes 0.02 to 0.5 m)"),
        ("spacing", 0.55, SPACING, None),
        ("above_5", 0.02, [0.2, 0.25, 0.4, 0.5, 0.6], "2 % of the points are more than 5 m high (training scenes 20 to 60 %)"),
        ("above_5", 0.18, [0.2, 0.25, 0.4, 0.5, 0.6], None),
        ("intensities", 9.0, [256, 256, 256, 15000, 15000], "the intensity has 9 distinct values (training scenes 256 to 15,000)"),
        ("density", 4.0, [30, 40, 100, 300, 1200], "the median density is 4 points per m² (training scenes 30 to 1,200 points per m²)"),
    ],
)  # fmt: skip
def test_unusual_facts_in_words(name, value, span, sentence):
    assert unusual_facts({name: value}, {name: span}) == ([] if sentence is None else [sentence])


def test_facts_that_one_side_lacks_are_not_compared():
    assert unusual_facts({"ground": 0.1}, {"spacing": SPACING}) == []
    assert unusual_facts({"unknown": 0.1}, {"unknown": SPACING}) == []


def test_damaged_range_names_the_fact():
    with pytest.raises(DataError, match=r"training_facts of 'spacing' .*got \[1\]"):
        unusual_facts({"spacing": 1.0}, {"spacing": [1]})
