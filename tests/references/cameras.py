"""Brute-force references for cameras, visibility and fusion."""

import numpy as np


def nearest_disc(u, v, z, *, focal, diameter, width, height, largest=12.0):
    """Return the row of the nearest disc in each cell by testing all points."""
    index = np.full((height, width), -1)
    for y in range(height):
        for x in range(width):
            best = np.inf
            for i in range(len(z)):
                radius = min(0.5 * diameter * focal / z[i], largest)
                own = (x, y) == (round(float(u[i])), round(float(v[i])))
                covered = (
                    np.hypot(x - u[i], y - v[i]) <= radius
                    if radius > 1
                    else max(abs(x - u[i]), abs(y - v[i])) <= radius
                )
                if (covered or (own and radius < 0.5)) and z[i] < best:
                    best, index[y, x] = z[i], i
    return index


def seen_past_rectangles(points, eye, rectangles):
    """Return which points no rectangle (x, y and z ranges, one of them empty) occludes."""
    free = np.ones(len(points), dtype=bool)
    for rectangle in rectangles:
        low, high = np.asarray(rectangle, float)
        axis = int(np.argmin(high - low))
        for i, point in enumerate(points):
            step = point[axis] - eye[axis]
            if step == 0:
                continue
            t = (low[axis] - eye[axis]) / step
            where = eye + t * (point - eye)
            others = [a for a in range(3) if a != axis]
            if 0 < t < 1 - 1e-6 and (where[others] > low[others]).all() and (where[others] < high[others]).all():
                free[i] = False
    return free
