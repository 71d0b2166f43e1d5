"""Doubtful clusters: planted ones are found with their reason, alike ones in the right place are not."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.inventory.objects.doubts import (
    DOUBTS,
    IN_THE_AIR,
    IN_VEGETATION,
    ON_FACADE,
    VEHICLE_SIZED,
    Cells,
    doubtful_clusters,
    worth_of_look,
)

NAMES = ("paved ground", "tree", "low vegetation", "building", "sign", "vehicle")
GROUND, TREE, LOW, BUILDING, SIGN, VEHICLE = range(6)


def box(rng, low, high, n=4000):
    return rng.uniform(low, high, (n, 3))


@pytest.fixture(scope="module")
def parts():
    """A road, a car labelled low vegetation, a hedge before a tree, a patch of a facade labelled tree, a sign in a
    crown and one on a road, a vehicle in the air and one on the road."""
    rng = np.random.default_rng(4)
    return {
        "road": (GROUND, box(rng, [0, 0, 0], [60, 30, 0.05], 60_000)),
        VEHICLE_SIZED: (LOW, box(rng, [10, 10, 0.1], [14, 11.8, 1.5])),
        "long hedge": (LOW, box(rng, [20, 10, 0.1], [32, 11, 1.2])),
        "hedge": (LOW, box(rng, [40, 10, 0.1], [43, 11.4, 1.2])),
        "tree": (TREE, box(rng, [40, 11.4, 0.5], [43, 14, 6], 12_000)),
        "facade": (BUILDING, box(rng, [0, 29, 0], [60, 29.3, 12], 60_000)),
        ON_FACADE: (TREE, box(rng, [20, 28.9, 4], [23, 29.4, 7])),
        IN_VEGETATION: (SIGN, box(rng, [41, 12, 3], [41.8, 12.8, 3.8], 500)),
        "sign": (SIGN, box(rng, [50, 5, 2], [50.7, 5.1, 2.7], 500)),
        IN_THE_AIR: (VEHICLE, box(rng, [50, 20, 3], [54, 21.8, 4.4])),
        "vehicle": (VEHICLE, box(rng, [30, 20, 0.1], [34, 21.8, 1.5])),
    }


def test_each_planted_cluster_is_found_with_its_reason_and_no_other(parts):
    xyz = np.concatenate([points for _, points in parts.values()])
    label = np.concatenate([np.full(len(points), name) for name, points in parts.values()])
    of_part = np.repeat(list(parts), [len(points) for _, points in parts.values()])
    table, owner = doubtful_clusters(Cells(xyz, xyz[:, 2], label, NAMES))
    assert sorted(table["reason"]) == sorted(DOUBTS)
    for k, row in table.iterrows():
        assert set(of_part[owner == k]) == {row["reason"]}
        own = parts[row["reason"]][1]
        assert row["points"] == (owner == k).sum() > 0.98 * len(own)
        assert np.abs(row[["x", "y", "z"]].to_numpy(float) - own.mean(axis=0)).max() < 0.2
    assert (owner[np.isin(of_part, ["road", "hedge", "long hedge", "tree", "sign", "vehicle", "facade"])] == -1).all()


def test_order_of_points_and_origin_do_not_matter(parts):
    xyz = np.concatenate([points for _, points in parts.values()])
    label = np.concatenate([np.full(len(points), name) for name, points in parts.values()])
    shuffled = np.random.default_rng(1).permutation(len(xyz))
    one, _ = doubtful_clusters(Cells(xyz, xyz[:, 2], label, NAMES))
    other, _ = doubtful_clusters(Cells(xyz[shuffled], xyz[shuffled, 2], label[shuffled], NAMES))
    assert list(one["reason"]) == list(other["reason"])
    np.testing.assert_allclose(one["points"], other["points"], rtol=0.01)


def test_small_clusters_and_no_points_are_no_clusters(parts):
    label, points = parts[VEHICLE_SIZED]
    few = Cells(points[::50], points[::50, 2], np.full(len(points[::50]), label), NAMES)
    assert doubtful_clusters(few)[0].empty
    none = Cells(points[:0], points[:0, 2], np.zeros(0, int), NAMES)
    table, owner = doubtful_clusters(none)
    assert table.empty and len(owner) == 0 and {"reason", "class", "points", "x", "y", "z"} <= set(table)


def test_worth_rises_with_doubt_points_and_nearness():
    def worth(name="building", confidence=0.7, extent=1.0, points=1000, distance=10.0, *, unlikely=False):
        given = ([name], [confidence], [extent], [points], [distance])
        return float(worth_of_look(*given, unlikely=[unlikely])[0])

    assert worth(confidence=0.5) > worth() > worth(confidence=0.95)
    assert worth(points=5000) > worth() > worth(points=99) > worth(points=30)
    assert worth() == worth(distance=np.nan) > 50 * worth(distance=41.0)
    assert worth("low vegetation") > worth() and worth(unlikely=True) > worth()
    assert worth("natural ground", extent=0.6) > worth("natural ground", extent=0.3)
