"""Evidence of the cells of a scene against sums point by point."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.inventory.objects import evidence
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import GROUPS, ClassEvidence


def test_cells_hold_the_means_of_their_points(rng):
    local, origin = rng.uniform(0, 1.5, (600, 3)), np.array([100.03, -7.1, 3.0])
    core, owner = rng.random(600) < 0.6, rng.integers(-1, 20, 600).astype(np.int32)
    shares = np.eye(len(GROUPS), dtype=np.float32)
    known = ClassEvidence(rng.dirichlet(np.ones(len(GROUPS)), 20).astype(np.float32), owner, shares)
    cells = evidence.SceneCells(local, core=core, origin=origin, evidence=known)
    key = np.floor((local + origin) / evidence.CELL).astype(int)
    np.testing.assert_array_equal(cells.key[cells.of_point], key)
    assert len(cells.key) == len(np.unique(key, axis=0))
    for cell in range(len(cells.key)):
        mine = np.flatnonzero((key == cells.key[cell]).all(axis=1))
        assert cells.count[cell] == len(mine) and cells.core_share[cell] == core[mine].mean()
        total = sum((known.of_groups[owner[i]] for i in mine if owner[i] >= 0), np.zeros(len(GROUPS), np.float32))
        np.testing.assert_array_equal(cells.groups[cell], total.astype(np.float64) / len(mine))


def test_the_object_with_most_points_is_that_of_a_sort(rng):
    cell, n_points = np.sort(rng.integers(0, 40, 300)), rng.integers(1, 5, 300)
    best = np.lexsort((np.arange(300), -n_points, cell))
    best = best[np.concatenate([[True], np.diff(cell[best]) != 0])]
    np.testing.assert_array_equal(evidence._with_most_points(cell, n_points), best)


@pytest.mark.parametrize("most", [0, 1 << 24])
def test_no_cell_within_reach_of_an_object_is_missed(rng, monkeypatch, most):
    monkeypatch.setattr(evidence, "_MOST_BLOCKS", most)
    around = evidence._cells_around.py_func
    centre, share = rng.uniform(0, 8, (700, 3)), rng.integers(0, 2, 700) / 2
    objects = np.flatnonzero((centre < [3, 4, 2]).all(axis=1))[::4]
    found = around(centre, share, objects)
    distance, _ = cKDTree(centre[objects]).query(centre)
    free = (share > 0) & ~np.isin(np.arange(700), objects)
    assert np.isin(np.flatnonzero(free & (distance <= evidence.REACH)), found).all()
    assert free[found].all() and (np.diff(found) > 0).all() and len(found) < free.sum()
    if most:
        np.testing.assert_array_equal(evidence._cells_around(centre, share, objects), found)
