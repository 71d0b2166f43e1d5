"""Projection of points onto a polyline in plan, with a tree of capsules around its segments."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LEAF = 4  # segments per leaf: testing four costs about as much as another level of capsules
_STACK = 64
_SLACK = 1e-6  # metres, added to each radius: far above the rounding of coordinates up to 10^6 m
_NOWHERE = 1e300  # place of a capsule without segments: its squared distance from any point is infinite


@njit(cache=True)
def build_capsules(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Build a binary tree of capsules around consecutive segments.

    A capsule has all places up to a radius from its chord, which joins the ends of the segments. Unlike a bounding box
    it is thin in any direction of the line, so that few capsules are as near as the nearest segment.
    """
    n_segments = len(xy) - 1
    n_leaves = 1
    while n_leaves * _LEAF < n_segments:
        n_leaves *= 2
    capsules = np.zeros((2 * n_leaves, 6))
    for node in range(len(capsules)):
        capsules[node, 0] = capsules[node, 1] = _NOWHERE
    first, width = n_leaves, _LEAF
    while first > 0:
        for k in range((n_segments + width - 1) // width):
            start, stop = k * width, min((k + 1) * width, n_segments)
            row = capsules[first + k]
            row[0], row[1] = xy[start, 0], xy[start, 1]
            row[2], row[3] = xy[stop, 0] - xy[start, 0], xy[stop, 1] - xy[start, 1]
            squared = row[2] * row[2] + row[3] * row[3]
            row[4] = 1.0 / squared if squared > 0.0 else 0.0
            farthest = 0.0  # the distance from a chord is largest at a vertex
            for vertex in range(start, stop + 1):
                farthest = max(farthest, _chord_distance(capsules, first + k, xy[vertex, 0], xy[vertex, 1]))
            row[5] = np.sqrt(farthest) + _SLACK
        first, width = first // 2, 2 * width
    return capsules


@njit(cache=True)
def _chord_distance(capsules: NDArray[np.float64], node: int, x: float, y: float) -> float:
    """Return the squared distance to the chord of a capsule."""
    dx, dy, ex, ey = x - capsules[node, 0], y - capsules[node, 1], capsules[node, 2], capsules[node, 3]
    t = min(max((dx * ex + dy * ey) * capsules[node, 4], 0.0), 1.0)
    return (dx - t * ex) * (dx - t * ex) + (dy - t * ey) * (dy - t * ey)


@njit(cache=True)
def _segment(segments: NDArray[np.float64], s: int, x: float, y: float) -> tuple[float, float]:
    """Return the squared distance to segment s and the fraction of its length at the nearest point."""
    ax, ay, ex, ey = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
    t = min(max(((x - ax) * ex + (y - ay) * ey) * segments[s, 4], 0.0), 1.0)
    # At t = 1 the end vertex itself: both segments at a vertex then give the same distance to the last bit.
    px = segments[s, 5] if t == 1.0 else ax + t * ex
    py = segments[s, 6] if t == 1.0 else ay + t * ey
    return (x - px) * (x - px) + (y - py) * (y - py), t


@njit(cache=True)
def _nearest(
    segments: NDArray[np.float64],
    capsules: NDArray[np.float64],
    x: float,
    y: float,
    guess: int,
    stack: NDArray[np.int64],
) -> tuple[int, float]:
    """Return the nearest segment and the fraction along it; ties go to the first segment, for any `guess`."""
    n_segments, n_leaves = len(segments), len(capsules) // 2
    best_d, best_t = _segment(segments, guess, x, y)
    best, reach = guess, np.sqrt(best_d)
    # Push the siblings on the path from the leaf of the guess to the root; the largest is visited first. After a good
    # guess most are pruned at once, after a bad one the search starts near the root.
    node = n_leaves + guess // _LEAF
    stack[0], top = node, 1
    while node > 1:
        stack[top] = node ^ 1
        top += 1
        node //= 2
    while top > 0:
        top -= 1
        node = stack[top]
        if _chord_distance(capsules, node, x, y) > (reach + capsules[node, 5]) ** 2:
            continue
        while node < n_leaves:  # descend to the child with the nearer chord; push the other if within reach
            left, right = 2 * node, 2 * node + 1
            d_left, d_right = _chord_distance(capsules, left, x, y), _chord_distance(capsules, right, x, y)
            near, far, d_far = (left, right, d_right) if d_left <= d_right else (right, left, d_left)
            if d_far <= (reach + capsules[far, 5]) ** 2:
                stack[top] = far
                top += 1
            node = near
        first = (node - n_leaves) * _LEAF
        for s in range(first, min(first + _LEAF, n_segments)):
            d, t = _segment(segments, s, x, y)
            if d < best_d or (d == best_d and s < best):
                best, best_d, best_t = s, d, t
        reach = np.sqrt(best_d)
    return best, best_t


@njit(cache=True)
def locate(
    points: NDArray[np.float64],
    xy: NDArray[np.float64],
    station: NDArray[np.float64],
    capsules: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the station and signed offset of points along a polyline."""
    n, n_segments = len(points), len(xy) - 1
    segments = np.empty((n_segments, 7))
    for i in range(n_segments):
        segments[i, 0], segments[i, 1] = xy[i, 0], xy[i, 1]
        segments[i, 2], segments[i, 3] = xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1]
        segments[i, 4] = 1.0 / (segments[i, 2] ** 2 + segments[i, 3] ** 2)
        segments[i, 5], segments[i, 6] = xy[i + 1, 0], xy[i + 1, 1]
    out_station, out_offset = np.empty(n), np.empty(n)
    stack = np.empty(_STACK, np.int64)
    s = np.int64(0)  # a literal would compile a second version
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        s, t = _nearest(segments, capsules, x, y, s, stack)  # the segment of the previous point bounds the search
        ex, ey = xy[s + 1, 0] - xy[s, 0], xy[s + 1, 1] - xy[s, 1]
        length = np.sqrt(ex * ex + ey * ey)
        ux, uy = ex / length, ey / length
        if (s == 0 and t == 0.0) or (s == n_segments - 1 and t == 1.0):
            dx, dy = x - xy[s, 0], y - xy[s, 1]
            out_station[i] = station[s] + (dx * ux + dy * uy)
            out_offset[i] = dx * uy - dy * ux
            continue
        px, py = xy[s, 0] + t * ex, xy[s, 1] + t * ey
        out_station[i] = station[s] + t * (station[s + 1] - station[s])
        other = s + 1 if t == 1.0 else s - 1
        if t in (0.0, 1.0):
            # At a vertex both segments are equally near and may differ in side: use their mean direction.
            px, py = xy[s + int(t), 0], xy[s + int(t), 1]
            fx, fy = xy[other + 1, 0] - xy[other, 0], xy[other + 1, 1] - xy[other, 1]
            norm = np.sqrt(fx * fx + fy * fy)
            ux, uy = ux + fx / norm, uy + fy / norm
        dx, dy = x - px, y - py
        distance = np.sqrt(dx * dx + dy * dy)
        out_offset[i] = distance if dx * uy - dy * ux >= 0.0 else -distance
    return out_station, out_offset
