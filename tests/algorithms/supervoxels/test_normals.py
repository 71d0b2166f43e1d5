"""The eigenvector kernel against NumPy."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.supervoxels._features import BLOCK, smallest_eigenvectors


def solve(covariances):
    """Run the kernel on (n, 3, 3) matrices, n at most BLOCK."""
    rows = np.stack([covariances[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))])
    out = np.empty((3, len(covariances)))
    smallest_eigenvectors(rows, len(covariances), out)
    return out.T


@pytest.mark.parametrize("smallest", [0.0, 1e-6, 0.1, 0.45])
def test_equals_numpy_where_the_eigenvalue_stands_alone(rng, smallest):
    values = np.c_[np.full(BLOCK, smallest), rng.uniform(0.55, 3.0, (BLOCK, 2))]
    frames = np.linalg.qr(rng.standard_normal((BLOCK, 3, 3)))[0]
    found = solve(np.einsum("nij,nj,nkj->nik", frames, values, frames))
    np.testing.assert_allclose(np.abs((found * frames[:, :, 0]).sum(axis=1)), 1.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)


def test_point_line_and_ball_have_no_normal():
    line = np.outer([1.0, 2.0, -0.5], [1.0, 2.0, -0.5])
    assert (solve(np.stack([np.zeros((3, 3)), line, np.eye(3) * 0.3])) == 0).all()
