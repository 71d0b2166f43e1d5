import numpy as np
import pytest

from mlsroad_pipeline.algorithms.geometry.thinning import first_in_cells


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("n", [0, 1, 50, 20_000, 200_000])
def test_first_point_of_each_cell_is_that_of_numpy(rng, dtype, n):
    xyz = rng.normal(0, 5, (n, 3)).astype(dtype)
    xyz[::3] = np.round(xyz[::3] * 10) / 10  # faces between cells
    cells = np.floor(xyz / 0.1).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    np.testing.assert_array_equal(first_in_cells(xyz, 0.1), np.sort(first))
