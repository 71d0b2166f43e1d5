"""Upright lines: thinly scanned poles, what separates poles from trunks, and the crowns around their ends."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence
from mlsroad_pipeline.algorithms.inventory.objects.evidence import SceneCells
from mlsroad_pipeline.algorithms.inventory.objects.stem_features import (
    CROWN_FEATURES,
    STEM_FEATURES,
    crown_features,
    find_scene_stems,
)
from mlsroad_pipeline.algorithms.segmentation.stems import Stem


def scanned_pole(height, *, step=0.1, radius=0.1, lean=0.0, bow=0.0, arm=False):
    """Points of scan lines `step` apart on the seen half of a pole at the origin, with an arm of 2 m near its top."""
    z = np.repeat(np.arange(0.05, height, step), 3)
    angle = np.tile([-0.9, 0.0, 0.9], len(z) // 3)
    x = radius * np.cos(angle) + lean * z + bow * (1 - (2 * z / height - 1) ** 2)
    points = [np.column_stack([x, radius * np.sin(angle), z])]
    if arm:
        reach = np.arange(0.1, 2.0, 0.05)
        points.append(np.column_stack([lean * height + reach, 0 * reach, np.full(len(reach), height - 0.2)]))
    return np.concatenate(points)


def crown(bottom, top, radius=1.5):
    """Points of foliage around the origin."""
    draw = np.random.default_rng(5)
    xyz = draw.uniform([-radius, -radius, bottom], [radius, radius, top], (6000, 3))
    return xyz[np.hypot(xyz[:, 0], xyz[:, 1]) < radius]


def stems_of(xyz):
    """Find stems among points that all have the class tree."""
    evidence = ClassEvidence(
        np.array([[1.0]], np.float32), np.zeros(len(xyz), np.int64), np.array([[0, 0, 1.0] + [0.0] * 8])
    )
    cells = SceneCells(xyz, core=np.ones(len(xyz), np.bool_), origin=np.zeros(3), evidence=evidence)
    stems = find_scene_stems(xyz, xyz[:, 2], np.arange(len(xyz)), cells)
    return [dict(zip(STEM_FEATURES, row, strict=True)) for row in stems.features], stems.owner


@pytest.mark.parametrize("step", [0.1, 0.28, 0.4])
def test_a_pole_with_few_scan_lines_is_one_line(step):
    xyz = scanned_pole(12.0, step=step, radius=0.17, lean=0.07)
    (stem,), owner = stems_of(xyz)
    assert stem["length"] > 11.0
    assert stem["slope"] == pytest.approx(0.07, abs=0.01)
    assert (owner == 0).mean() > 0.95


def test_an_arm_fills_one_layer_and_a_crown_many():
    pole = max(stems_of(scanned_pole(8.0, arm=True))[0], key=lambda stem: stem["length"])
    foliage = crown(5.6, 8.0)
    foliage = foliage[np.hypot(foliage[:, 0], foliage[:, 1]) > 0.28][::2]
    trunk = max(stems_of(np.concatenate([scanned_pole(8.0), foliage]))[0], key=lambda stem: stem["length"])
    assert trunk["length"] > 7.0
    assert pole["high_filled"] < 0.4
    assert trunk["high_filled"] > 0.8
    assert pole["high_ring"] < trunk["high_ring"]
    assert pole["low_filled"] == trunk["low_filled"] == 0.0


def test_a_crown_above_a_trunk_is_counted():
    trunk = max(stems_of(np.concatenate([scanned_pole(4.0), crown(3.9, 6.5)]))[0], key=lambda stem: stem["length"])
    bare = stems_of(scanned_pole(4.0))[0][0]
    assert bare["overhead"] == 0.0
    assert trunk["length"] < 5.0
    assert np.expm1(trunk["overhead"]) > 500


def test_bow_is_that_of_the_line():
    assert stems_of(scanned_pole(6.0, lean=0.05))[0][0]["bow"] < 0.03
    bent = stems_of(scanned_pole(6.0, bow=0.12))[0][0]
    # Means of the thirds of a parabola of height b: 14/27 b, 26/27 b, 14/27 b.
    assert bent["bow"] == pytest.approx(2 * 12 / 27 * 0.12, abs=0.03)


def line(low=0.0, high=8.0, base=(2.0, 3.0), slope=(0.05, 0.0)):
    return Stem(np.array(base), np.array(slope), low, high)


def foliage(middle, radius, low, high, n=4000, seed=0):
    rng = np.random.default_rng(seed)
    turn, reach = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.uniform(0, 1, n))
    return np.column_stack([
        middle[0] + reach * np.cos(turn), middle[1] + reach * np.sin(turn), rng.uniform(low, high, n)
    ])  # fmt: skip


def crowns_of(stems, xyz):
    return [dict(zip(CROWN_FEATURES, row, strict=True)) for row in crown_features(stems, xyz)]


def test_features_are_those_of_a_loop_over_places():
    stem, xyz = line(), foliage((3.0, 3.5), 5.0, 2.0, 12.0)
    (found,) = crowns_of([stem], xyz)
    inner, outer, beside, above, top = 0, 0, 0, [], 0.0
    for x, y, z in xyz:
        dx, dy = x - 2.0 - 0.05 * z, y - 3.0
        r = np.hypot(dx, dy)
        if r >= 3.5:
            continue
        inner += r < 1.0 and z > 8.0
        outer += r >= 1.0 and z > 7.5
        beside += r > 0.3 and 4.0 < z <= 7.5
        if (z > 7.5 and r > 0.3) or z > 8.0:
            above.append((dx, dy, r))
            top = max(top, z - 8.0)
    above = np.array(above)
    assert found["crown_inner"] == pytest.approx(np.log1p(inner))
    assert found["crown_outer"] == pytest.approx(np.log1p(outer))
    assert found["beside"] == pytest.approx(np.log1p(beside))
    assert found["crown_aside"] == pytest.approx(np.hypot(*above[:, :2].mean(axis=0)) / above[:, 2].mean())
    assert found["crown_depth"] == pytest.approx(top)


def test_a_crown_lies_around_the_end_and_that_of_a_neighbour_aside():
    stem = line(slope=(0.0, 0.0))
    palm, beside, free = (
        crowns_of([stem], xyz)[0]
        for xyz in (
            foliage((2.0, 3.0), 2.5, 7.5, 10.0),
            foliage((4.5, 3.0), 2.0, 4.0, 10.0),
            foliage((40.0, 3.0), 2.0, 4.0, 10.0),
        )
    )
    assert palm["crown_aside"] < 0.1
    assert beside["crown_aside"] > 0.8
    assert palm["beside"] == 0.0 < beside["beside"]
    assert palm["crown_outer"] > 6.0 and palm["crown_inner"] > 5.0
    assert (free["crown_outer"], free["crown_inner"], free["crown_depth"]) == (0.0, 0.0, 0.0)
    assert np.isnan(free["crown_aside"])


def test_a_leaning_line_is_extended_to_the_crown():
    leaning = line(slope=(0.3, 0.0))
    (found,) = crowns_of([leaning], foliage(leaning.at(9.0), 1.0, 8.5, 9.5))
    assert found["crown_aside"] < 0.15


def test_without_stems_there_is_no_row_of_crowns():
    assert crown_features([], np.zeros((3, 3))).shape == (0, len(CROWN_FEATURES))
