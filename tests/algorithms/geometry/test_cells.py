"""Cells, their sort and their hash table against NumPy and SciPy."""

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.geometry.cells import (
    bounding_box,
    build_cell_grids,
    build_table,
    find_key,
    order_of_cells,
    sort_into_cells,
)
from mlsroad_pipeline.algorithms.geometry.threads import run_in_chunks

UTM = np.array([451_234.5, 5_412_987.25, 312.0])


def centres(grid):
    """Return the centres of the occupied cells of a grid, from their keys."""
    nx, ny, _ = grid.shape
    indices = np.stack([grid.keys % nx, grid.keys // nx % ny, grid.keys // (nx * ny)], axis=1)
    return grid.minimum + (indices - grid.margin + 0.5) * grid.cell_size


def test_the_grid_holds_every_point_once_in_its_cell(rng):
    xyz = rng.random((500, 3)) * 4 + UTM
    (grid,) = build_cell_grids(xyz, cell_size=0.5, margin=2)
    assert np.array_equal(np.sort(grid.order), np.arange(500))
    assert np.all(np.diff(grid.keys) > 0)
    assert np.all(np.abs(grid.local) <= 0.25 + 1e-6)
    cell = np.repeat(np.arange(len(grid.keys)), np.diff(grid.starts))
    assert np.allclose(centres(grid)[cell] + grid.local.T, xyz[grid.order], atol=1e-6)


def test_clouds_of_one_call_share_their_cells(rng):
    a, b = rng.random((50, 3)), rng.random((60, 3)) + 0.5
    grid_a, grid_b = build_cell_grids(a, b, cell_size=0.25)
    near = cKDTree(centres(grid_a)).query(centres(grid_b)[np.isin(grid_b.keys, grid_a.keys)])[0]
    assert np.all(near < 1e-12)


def test_the_bounding_box_is_numpys(rng):
    xyz = rng.normal(size=(100, 3)).astype(np.float32)
    assert np.array_equal(bounding_box(xyz), np.array([xyz.min(axis=0), xyz.max(axis=0)], dtype=np.float64))


def test_chunks_cover_all_items_in_order():
    assert run_in_chunks(lambda a, b: (a, b), 5, n_threads=1) == [(0, 5)]
    chunks = run_in_chunks(lambda a, b: list(range(a, b)), 100, n_threads=3)
    assert list(itertools.chain(*chunks)) == list(range(100))
    with pytest.raises(ParameterError, match="n_threads must be at least 1"):
        run_in_chunks(lambda a, b: None, 5, n_threads=0)


def test_bad_input_is_named():
    with pytest.raises(DataError, match="too large for cells of 1e-06 m"):
        build_cell_grids(np.array([[0.0, 0, 0], [1e4, 1e4, 1e4]]), cell_size=1e-6)
    with pytest.raises(DataError, match="at least one point"):
        build_cell_grids(np.empty((0, 3)), cell_size=1.0)
    with pytest.raises(ParameterError, match="cell_size must be"):
        build_cell_grids(np.zeros((1, 3)), cell_size=0.0)


def test_points_are_sorted_into_the_cells_of_floor(rng):
    local, origin = rng.normal(0.0, 2.0, (3000, 3)), np.array([583_000.3, -4_477_000.7, 12.0])
    index = np.floor((local + origin) / 0.3).astype(np.int64)
    cells = sort_into_cells(local, origin=origin, size=0.3)
    distinct, first, inverse = np.unique(index, axis=0, return_index=True, return_inverse=True)
    assert cells.packed
    np.testing.assert_array_equal(cells.order, np.lexsort(index.T[::-1]))
    np.testing.assert_array_equal(cells.index, distinct)
    np.testing.assert_array_equal(cells.order[cells.starts[:-1]], first)
    np.testing.assert_array_equal(cells.owner(), inverse.ravel())


def test_cells_far_apart_are_sorted_without_a_packed_key(rng):
    index = rng.integers(-(2**40), 2**40, (50, 3))
    np.testing.assert_array_equal(order_of_cells(index), np.lexsort(index.T[::-1]))
    cells = sort_into_cells(np.repeat(index, 2, axis=0) + 0.5, origin=np.zeros(3), size=1.0)
    assert not cells.packed
    np.testing.assert_array_equal(cells.index, index[np.lexsort(index.T[::-1])])
    np.testing.assert_array_equal(cells.starts, np.arange(0, 101, 2))


def test_no_points_have_no_cells():
    cells = sort_into_cells(np.zeros((0, 3)), origin=np.zeros(3), size=1.0)
    assert len(cells.order) == len(cells.index) == len(cells.owner()) == 0
    assert cells.starts.tolist() == [0]


def test_the_hash_table_finds_its_keys_alone(rng):
    keys = np.unique(rng.integers(0, 2**62, 500))
    slots, values = build_table(keys)
    assert [find_key(slots, values, int(key)) for key in keys] == list(range(len(keys)))
    assert find_key(slots, values, int(keys[0]) + 1) == -1
