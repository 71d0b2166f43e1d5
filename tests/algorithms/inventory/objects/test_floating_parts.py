import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.objects.fragments import join_floating_parts


def line(start, stop, n=40):
    return np.linspace(start, stop, n)


def joined(*clusters, ground=0.0):
    """Return the cluster of each of the given clusters after joining, and the points in another order give the same."""
    xyz = np.concatenate(clusters)
    label = np.repeat(np.arange(len(clusters)), [len(cluster) for cluster in clusters])
    height = xyz[:, 2] - ground
    out = join_floating_parts(xyz, height, label)
    order = np.random.default_rng(3).permutation(len(xyz))
    np.testing.assert_array_equal(join_floating_parts(xyz[order], height[order], label[order]), out[order])
    found = [np.unique(out[label == number]) for number in range(len(clusters))]
    assert all(len(one) == 1 for one in found)
    return [int(one[0]) for one in found]


MAST = line((0, 0, 0.1), (0, 0, 8.0))
LAMP = line((1.0, 0, 8.2), (1.6, 0, 8.3), 8)


def test_lamp_beyond_a_gap_belongs_to_its_mast():
    assert joined(MAST, LAMP) == [0, 0]
    assert joined(LAMP, MAST) == [1, 1]


def test_arm_carries_the_lamp_beyond_it():
    arm = line((0.7, 0, 8.1), (1.4, 0, 8.2), 8)
    lamp = line((2.5, 0, 8.2), (3.1, 0, 8.2), 8)
    assert joined(MAST, arm, lamp) == [0, 0, 0]
    assert joined(MAST, lamp) == [0, 1]


@pytest.mark.parametrize(
    "part",
    [
        line((0.8, -9, 8.0), (0.8, 9, 8.0), 200),  # a wire
        line((0.8, 0, 3.0), (0.8, 0, 3.5)),  # far below the top
        line((0.8, 0, 2.0), (0.8, 0, 6.0)),  # starts below 2.5 m
        line((1.5, 0, 8.0), (2.0, 0, 8.0)),  # too far away
    ],
)
def test_other_clusters_stay_apart(part):
    assert joined(MAST, part) == [0, 1]


def test_part_belongs_to_the_nearer_of_two_masts():
    other = line((2.4, 0, 0.1), (2.4, 0, 8.0))
    assert joined(other, MAST, line((0.9, 0, 8.0), (1.1, 0, 8.0))) == [0, 1, 1]


def test_low_posts_carry_nothing():
    assert joined(line((0, 0, 0), (0, 0, 2.8)), line((0.5, 0, 2.9), (0.8, 0, 3.0))) == [0, 1]


def test_unknown_heights_join_nothing():
    xyz = np.concatenate([MAST, LAMP])
    label = np.repeat([0, 1], [len(MAST), len(LAMP)])
    np.testing.assert_array_equal(join_floating_parts(xyz, np.full(len(xyz), np.nan), label), label)
    assert join_floating_parts(np.zeros((0, 3)), np.zeros(0), np.zeros(0, int)).shape == (0,)
