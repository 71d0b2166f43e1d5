"""Vertices of the convex hull of points that mostly lie close beneath it, such as those of a spherical flip.

Incremental hull: the farthest point of each cell of direction is inserted first, from coarse to fine cells, then the
rest, in an order that preserves locality. The facet above a point is then one or two steps from that of the previous
point, and most points are rejected at the first test.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BITS = 11  # per coordinate of a direction on a face of a cube: cells of about a milliradian
_LEVELS = 5  # of cells; each has four times finer cells than the one before
_ROUNDING = 4e-15  # rounding error of a volume, as a share of the product of three edges
_FLAT = 1e-9  # minimum width of the first tetrahedron, as a share of its length


def hull_vertices(points: NDArray[np.float64]) -> NDArray[np.int64] | None:
    """Return the vertices of the convex hull."""
    corners = _first_corners(points)
    if corners is None:
        return None
    centred = points - points[corners].mean(axis=0)
    order = insertion_order(centred)
    order = np.concatenate([corners, order[~np.isin(order, corners)]])
    on_hull = _grow(centred[order])
    return np.sort(order[on_hull]) if len(on_hull) else None


def insertion_order(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the insertion order of points."""
    code, distance = _direction_codes(points)
    n = len(points)
    row = np.sort(code * n + np.arange(n)) % n
    return row[_by_level(code[row], distance[row])]


def _first_corners(points: NDArray[np.float64]) -> NDArray[np.int64] | None:
    """Return four points that are far apart; None if all are coplanar."""
    a = int(np.argmin(points[:, 0]))
    from_a = points - points[a]
    square = (from_a**2).sum(axis=1)
    b = int(square.argmax())
    if square[b] == 0:
        return None
    along = from_a[b] / np.sqrt(square[b])
    across = from_a - (from_a @ along)[:, None] * along
    square_across = (across**2).sum(axis=1)
    c = int(square_across.argmax())
    height = np.abs(from_a @ np.cross(along, across[c]))
    d = int(height.argmax())
    if height[d] <= _FLAT * square[b] or square_across[c] <= _FLAT**2 * square[b]:
        return None
    return np.array([a, b, c, d])


@njit(cache=True, nogil=True, error_model="numpy")
def _direction_codes(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cell of each direction, in Morton order on the faces of a cube, and the squared distance."""
    n = len(points)
    code, distance = np.zeros(n, dtype=np.int64), np.empty(n)
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        distance[i] = x * x + y * y + z * z
        side, first, second, largest = 0, y, z, x
        if abs(y) > abs(largest):
            side, first, second, largest = 1, z, x, y
        if abs(z) > abs(largest):
            side, first, second, largest = 2, x, y, z
        if largest == 0.0:
            continue
        half = 0.5 * (1 << _BITS)
        u = min(int((first / abs(largest) + 1.0) * half), (1 << _BITS) - 1)
        v = min(int((second / abs(largest) + 1.0) * half), (1 << _BITS) - 1)
        cell = 2 * side + (largest < 0)
        for bit in range(_BITS - 1, -1, -1):
            cell = cell * 4 + 2 * ((v >> bit) & 1) + ((u >> bit) & 1)
        code[i] = cell
    return code, distance


@njit(cache=True, nogil=True, error_model="numpy")
def _by_level(code: NDArray[np.int64], distance: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return rows of sorted codes: the farthest of each cell, from coarse to fine levels, then all others."""
    n = len(code)
    order, taken, m = np.empty(n, dtype=np.int64), np.zeros(n, dtype=np.bool_), 0
    for level in range(_LEVELS):
        shift, i = 4 * (_LEVELS - 1 - level), 0
        while i < n:
            cell, best = code[i] >> shift, i
            while i < n and code[i] >> shift == cell:
                if distance[i] > distance[best]:
                    best = i
                i += 1
            if not taken[best]:
                order[m], taken[best] = best, True
                m += 1
    for i in range(n):
        if not taken[i]:
            order[m] = i
            m += 1
    return order


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _volume(
    p: NDArray[np.float64], a: int, b: int, c: int, px: float, py: float, pz: float, rounding: float
) -> float:  # fmt: skip
    """Return the volume spanned by two edges from point a and a third one; 0 within the rounding error."""
    ux, uy, uz = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
    vx, vy, vz = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1], p[c, 2] - p[a, 2]
    volume = px * (uy * vz - uz * vy) + py * (uz * vx - ux * vz) + pz * (ux * vy - uy * vx)
    squares = (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz) * (px * px + py * py + pz * pz)
    return volume if volume * volume > rounding * rounding * squares else 0.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _above(p: NDArray[np.float64], a: int, b: int, c: int, q: int, rounding: float) -> bool:
    """Return whether point q is above the plane of a facet by more than the rounding error."""
    return _volume(p, a, b, c, p[q, 0] - p[a, 0], p[q, 1] - p[a, 1], p[q, 2] - p[a, 2], rounding) > 0.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _beyond(p: NDArray[np.float64], a: int, b: int, q: int) -> bool:
    """Return whether the direction of point q is outside the edge from a to b, seen from the origin."""
    return _volume(p, a, b, q, p[a, 0], p[a, 1], p[a, 2], _ROUNDING) < 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _grow(p: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the vertices of the hull; none if the surface became inconsistent.

    Facet f has the vertices corner[f], anticlockwise from outside; beside[f, k] is the facet across the edge opposite
    its vertex k. Rows of removed facets are reused: `rows` counts the rows in use and the free ones.
    """
    n = len(p)
    room = 2 * n + 8  # a hull of n vertices has at most 2 n - 4 facets
    corner, beside = np.empty((room, 3), dtype=np.int32), np.empty((room, 3), dtype=np.int32)
    free, removed, mark = np.empty(room, np.int32), np.empty(room, np.int32), np.zeros(room, np.int32)
    horizon, begins = np.empty((room, 3), dtype=np.int32), np.zeros((n, 2), dtype=np.int32)
    rows = np.array([4, 0])
    _first_facets(p, corner, beside)
    near = 0
    for q in range(4, n):
        near = _facet_towards(p, corner, beside, near, q)
        if near < 0:
            break
        if not _above(p, corner[near, 0], corner[near, 1], corner[near, 2], q, _ROUNDING):
            continue
        gone, edges = _seen_from(p, corner, beside, near, q, removed, horizon, mark)
        if not 3 <= edges <= gone + 2:
            near = -1
            break
        for k in range(gone):
            corner[removed[k], 0] = -1
            free[rows[1] + k] = removed[k]
        rows[1] += gone
        near = _put_facets(q, horizon[:edges], corner, beside, begins, free, rows)
        if near < 0:
            break
    return _checked(p, corner[: rows[0]], beside[: rows[0]]) if near >= 0 else np.empty(0, dtype=np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def _first_facets(p: NDArray[np.float64], corner: NDArray[np.int32], beside: NDArray[np.int32]) -> None:
    """Initialise the four facets of the first four points."""
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])  # each faces one vertex:
    faced = np.array([3, 2, 1, 0])
    turned = _beyond(p, 0, 1, 2)
    for f in range(4):
        for k in range(3):
            corner[f, k] = faces[f, (2 - k) if turned else k]
            beside[f, k] = np.flatnonzero(faced == corner[f, k])[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _facet_towards(
    p: NDArray[np.float64], corner: NDArray[np.int32], beside: NDArray[np.int32], f: int, q: int
) -> int:  # fmt: skip
    """Walk to the facet that a ray from the zero to point q passes; -1 where the walk does not end."""
    for _ in range(len(corner)):
        a, b, c = corner[f]
        if _beyond(p, a, b, q):
            f = beside[f, 2]
        elif _beyond(p, b, c, q):
            f = beside[f, 0]
        elif _beyond(p, c, a, q):
            f = beside[f, 1]
        else:
            return f
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def _seen_from(
    p: NDArray[np.float64], corner: NDArray[np.int32], beside: NDArray[np.int32], first: int, q: int,
    removed: NDArray[np.int32], horizon: NDArray[np.int32], mark: NDArray[np.int32],
) -> tuple[int, int]:  # fmt: skip
    """List the facets that point q is above, and the edges around them with what lies beyond; return the numbers."""
    removed[0], gone, done, edges = first, 1, 0, 0
    mark[first] = q
    while done < gone:
        f = removed[done]
        done += 1
        for k in range(3):
            g = beside[f, k]
            if mark[g] == q:
                continue
            if _above(p, corner[g, 0], corner[g, 1], corner[g, 2], q, _ROUNDING):
                mark[g] = q
                removed[gone] = g
                gone += 1
            else:
                horizon[edges, 0], horizon[edges, 1], horizon[edges, 2] = corner[f, (k + 1) % 3], corner[f, k - 1], g
                edges += 1
                if edges == len(horizon):
                    return gone, 0
    return gone, edges


@njit(cache=True, nogil=True, error_model="numpy")
def _put_facets(
    q: int, horizon: NDArray[np.int32], corner: NDArray[np.int32], beside: NDArray[np.int32],
    begins: NDArray[np.int32], free: NDArray[np.int32], rows: NDArray[np.int64],
) -> int:  # fmt: skip
    """Join point q to the edges of the horizon; return a new facet, or -1 where they are not one ring."""
    first = -1
    for k in range(len(horizon)):
        a, b, g = horizon[k]
        if begins[a, 0] == q:  # two edges leave one vertex
            return -1
        if rows[1] > 0:
            rows[1] -= 1
            f = free[rows[1]]
        else:
            f = rows[0]
            rows[0] += 1
        begins[a, 0], begins[a, 1] = q, f
        corner[f, 0], corner[f, 1], corner[f, 2], beside[f, 0] = q, a, b, g
        for j in range(3):
            if corner[g, j] != a and corner[g, j] != b:
                beside[g, j] = f
        first = f
    f = first
    for k in range(len(horizon)):
        b = corner[f, 2]
        if begins[b, 0] != q:
            return -1
        g = begins[b, 1]
        beside[f, 1], beside[g, 2] = g, f
        f = g
        if f == first:
            return first if k == len(horizon) - 1 else -1
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def _checked(p: NDArray[np.float64], corner: NDArray[np.int32], beside: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the vertices of a surface that is convex at all of its edges; none of another one."""
    on_hull = np.zeros(len(p), dtype=np.bool_)
    for f in range(len(corner)):
        a, b, c = corner[f]
        if a < 0:
            continue
        on_hull[a] = on_hull[b] = on_hull[c] = True
        for k in range(3):
            g = beside[f, k]
            for j in range(3):
                w = corner[g, j]
                if w not in (a, b, c) and _above(p, a, b, c, w, 10 * _ROUNDING):
                    return np.empty(0, dtype=np.int64)
    return np.flatnonzero(on_hull)
