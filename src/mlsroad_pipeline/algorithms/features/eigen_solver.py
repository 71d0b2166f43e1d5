"""Vectorised, branch-free eigenvalues and eigenvectors of symmetric 3 x 3 matrices.

The isolated eigenvalue is the root of the characteristic cubic far from the other two. Newton's iteration computes it
to full precision. After deflation by its eigenvector, a 2 x 2 problem with a stable closed form remains. Unlike with
the trigonometric formula, the error of small eigenvalues is at the rounding error of the largest.
"""

from math import sqrt

from numba import njit
from numpy.typing import NDArray

# Without the flags that exclude NaN and infinity: undefined features are NaN.
FAST = {"reassoc", "contract", "arcp", "nsz"}


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _isolated_root(half_det: float) -> float:
    """Return the isolated root of b^3 - 3 b = 2 half_det, with the sign of `half_det`."""
    sign = 1.0 if half_det >= 0.0 else -1.0
    r = min(abs(half_det), 1.0)
    # With b = 2 c, c = cos(acos(r) / 3) lies in [cos(30 deg), 1], where the slope of 4 c^3 - 3 c is at least 6.
    c = 0.8660254037844386 + r * (0.16626 - 0.0322858 * r)
    c -= (4.0 * c * c * c - 3.0 * c - r) / (12.0 * c * c - 3.0)
    c -= (4.0 * c * c * c - 3.0 * c - r) / (12.0 * c * c - 3.0)
    c -= (4.0 * c * c * c - 3.0 * c - r) / (12.0 * c * c - 3.0)
    return 2.0 * c * sign


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _null_vector(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> tuple[float, float, float]:
    """Return the unit null vector of a matrix of rank two: the longest cross product of its rows."""
    ux, uy, uz = xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy
    vx, vy, vz = xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz
    wx, wy, wz = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
    first = vv > uu
    ux, uy, uz, uu = vx if first else ux, vy if first else uy, vz if first else uz, vv if first else uu
    second = ww > uu
    ux, uy, uz, uu = wx if second else ux, wy if second else uy, wz if second else uz, ww if second else uu
    degenerate = not uu > 0.0  # all eigenvalues are equal: use the coordinate axes
    norm = sqrt(1.0 if degenerate else uu)
    return (
        (0.0 if degenerate else ux) / norm,
        (0.0 if degenerate else uy) / norm,
        (1.0 if degenerate else uz) / norm,
    )


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _upper_vector(mss: float, mst: float, mtt: float) -> tuple[float, float, float, float]:
    """Return both eigenvalues of a symmetric 2 x 2 matrix, and the unit eigenvector (a, b) of the larger one."""
    middle, half = 0.5 * (mss + mtt), 0.5 * (mss - mtt)
    root = sqrt(half * half + mst * mst)
    steep = half >= 0.0
    a, b = half + root if steep else mst, mst if steep else root - half
    norm = sqrt(a * a + b * b)
    flat = not norm > 0.0
    return middle + root, middle - root, 1.0 if flat else a / norm, 0.0 if flat else b / norm


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def solve_symmetric(matrices: NDArray, n: int, values: NDArray, smallest: NDArray, largest: NDArray) -> None:
    """Solve the first n symmetric 3 x 3 eigenproblems of `matrices` (6, m): rows xx, xy, xz, yy, yz, zz.

    Writes the eigenvalues (3, m) in descending order, clipped at 0 (the matrices are covariances), and the unit
    eigenvectors of the smallest and of the largest, with z >= 0. NaN gives NaN.
    """
    for i in range(n):
        xx, xy, xz = matrices[0, i], matrices[1, i], matrices[2, i]
        yy, yz, zz = matrices[3, i], matrices[4, i], matrices[5, i]
        mean = (xx + yy + zz) / 3.0
        xx, yy, zz = xx - mean, yy - mean, zz - mean
        p = sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
        scale = 1.0 / p if p > 0.0 else 0.0
        xx, yy, zz, xy, xz, yz = xx * scale, yy * scale, zz * scale, xy * scale, xz * scale, yz * scale
        half_det = 0.5 * (xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz))
        isolated = _isolated_root(half_det)
        ux, uy, uz = _null_vector(xx - isolated, xy, xz, yy - isolated, yz, zz - isolated)
        # An orthonormal basis (s, t) of the plane perpendicular to u, without cancellation.
        wide = abs(ux) > abs(uy)
        sx, sy, sz = -uz if wide else 0.0, 0.0 if wide else uz, ux if wide else -uy
        norm = sqrt(sx * sx + sy * sy + sz * sz)
        sx, sy, sz = sx / norm, sy / norm, sz / norm
        tx, ty, tz = uy * sz - uz * sy, uz * sx - ux * sz, ux * sy - uy * sx
        bsx, bsy, bsz = xx * sx + xy * sy + xz * sz, xy * sx + yy * sy + yz * sz, xz * sx + yz * sy + zz * sz
        btx, bty, btz = xx * tx + xy * ty + xz * tz, xy * tx + yy * ty + yz * tz, xz * tx + yz * ty + zz * tz
        upper, lower, a, b = _upper_vector(
            sx * bsx + sy * bsy + sz * bsz, sx * btx + sy * bty + sz * btz, tx * btx + ty * bty + tz * btz
        )
        top = isolated > 0.0  # the isolated eigenvalue is the largest one
        values[0, i] = max(mean + p * (isolated if top else upper), 0.0)
        values[1, i] = max(mean + p * (upper if top else lower), 0.0)
        values[2, i] = max(mean + p * (lower if top else isolated), 0.0)
        # The eigenvector of `upper` is a s + b t, that of `lower` a t - b s.
        nx, ny, nz = a * tx - b * sx if top else ux, a * ty - b * sy if top else uy, a * tz - b * sz if top else uz
        lx, ly, lz = ux if top else a * sx + b * tx, uy if top else a * sy + b * ty, uz if top else a * sz + b * tz
        flip = -1.0 if nz < 0.0 else 1.0
        smallest[0, i], smallest[1, i], smallest[2, i] = nx * flip, ny * flip, nz * flip
        flip = -1.0 if lz < 0.0 else 1.0
        largest[0, i], largest[1, i], largest[2, i] = lx * flip, ly * flip, lz * flip
