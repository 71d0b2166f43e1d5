"""Brute-force references for clustering, trajectories and inventory kernels, and planted objects."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree


def renumber_by_first(labels):
    """Renumber labels by their first point."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), int)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse]


def radius_graph_components(xyz, tolerance, min_points=1):
    """Label the components of the radius graph with SciPy."""
    xyz = np.asarray(xyz, dtype=np.float64)
    pairs = cKDTree(xyz).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(xyz), len(xyz)))
    labels = renumber_by_first(connected_components(graph, directed=False)[1])
    small = np.bincount(labels)[labels] < min_points
    result = np.full(len(xyz), -1)
    if not small.all():
        result[~small] = renumber_by_first(labels[~small])
    return result


def nearest_on_polyline(points, vertices):
    """Return distance and running length of the nearest point of an open polyline, by brute force over the segments."""
    a, b = vertices[:-1], vertices[1:]
    along = b - a
    length = np.linalg.norm(along, axis=1)
    start = np.concatenate([[0.0], np.cumsum(length)])
    distances, stations = [], []
    for point in points:
        t = np.clip(((point - a) * along).sum(axis=1) / length**2, 0.0, 1.0)
        d = np.linalg.norm(a + t[:, None] * along - point, axis=1)
        best = int(np.argmin(d))
        distances.append(d[best])
        stations.append(start[best] + t[best] * length[best])
    return np.array(distances), np.array(stations)


def planted_pole(base, height, *, tilt_degrees=0.0, azimuth_degrees=0.0, radius=0.06, step=0.04):
    """Return points on the surface of a leaning pole, every `step` metres."""
    lean = np.tan(np.radians(tilt_degrees)) * np.array(
        [np.sin(np.radians(azimuth_degrees)), np.cos(np.radians(azimuth_degrees))]
    )
    z = np.arange(0.0, height + 1e-9, step)
    angle = np.arange(0, 2 * np.pi, np.pi / 6)
    z, angle = (grid.ravel() for grid in np.meshgrid(z, angle))
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([circle + lean * z[:, None], z]) + base


def planted_box(centre, length, width, height, *, azimuth_degrees=0.0, step=0.07):
    """Return points on the sides and the top of a box at a height; the azimuth is that of its length."""
    x, y, z = (np.linspace(0, 1, int(np.ceil(size / step)) + 1) for size in (length, width, height))
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    shell = (grid[:, 0] % 1 == 0) | (grid[:, 1] % 1 == 0) | (grid[:, 2] == 1)
    local = (grid[shell] - [0.5, 0.5, 0]) * [length, width, height]
    s, c = np.sin(np.radians(azimuth_degrees)), np.cos(np.radians(azimuth_degrees))
    turned = np.column_stack([local[:, 0] * s - local[:, 1] * c, local[:, 0] * c + local[:, 1] * s, local[:, 2]])
    return turned + centre


def planted_tree(base, height, crown_radius, step=0.25):
    """Return points of a trunk and of a filled ellipsoidal crown above 2 m."""
    half = (height - 2.0) / 2
    n = int(np.ceil(max(half, crown_radius) / step))
    grid = np.stack(np.meshgrid(*[np.arange(-n, n + 1) * step] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    unit = grid / [crown_radius, crown_radius, half]
    crown = grid[(unit**2).sum(axis=1) <= 1] + [0, 0, 2.0 + half]
    return np.concatenate([planted_pole(np.zeros(3), 2.2, radius=0.15), crown]) + base


def scanned_street(rng, *, rate=75.0, pulses=24_000, seconds=4.0, yaw=45.0, pitch=20.0, lever=(0, 0, 0), walls=True):
    """Return points and times of one line scanner on a van that drives an arc between two walls over flat ground.

    Returns points (n, 3), times (n,), and the scanner's true centre at those times (n, 3).
    """
    time = np.arange(0, seconds, 1 / pulses)
    way = 8.0 * time + 1.5 * np.sin(time)  # braking and accelerating
    heading = way / 120.0  # an arc of radius 120 m
    position = np.column_stack([120.0 * np.sin(heading), 120.0 * (1 - np.cos(heading)), np.full(len(time), 2.5)])
    c, s = np.cos(heading), np.sin(heading)
    forward, left = np.column_stack([c, s, 0 * c]), np.column_stack([-s, c, 0 * c])
    up = np.broadcast_to([0.0, 0.0, 1.0], forward.shape)
    centre = position + lever[0] * forward + lever[1] * left + lever[2] * up
    a, b = np.radians([yaw, pitch])
    axis = np.array([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), -np.sin(b)])  # of rotation, in the vehicle's frame
    first = np.cross(axis, [0, 0, 1])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    turn = 2 * np.pi * rate * time + 0.7
    local = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    beam = local[:, :1] * forward + local[:, 1:2] * left + local[:, 2:] * up
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(beam[:, 2] < 0, -centre[:, 2] / beam[:, 2], np.inf)
        sides = [np.where(beam[:, 1] * side > 0, (side * 15.0 - centre[:, 1]) / beam[:, 1], np.inf) for side in (1, -1)]
    distance = np.minimum.reduce([ground, *sides]) if walls else ground
    hit = (distance > 1.5) & (distance < 60.0)
    measured = distance[hit] + rng.normal(0, 0.01, hit.sum())
    return centre[hit] + measured[:, None] * beam[hit], time[hit], centre[hit]


def least_rectangle_area(xy, step=0.05):
    """Return the area of the minimum rectangle around points, by a search over directions."""
    areas = []
    for angle in np.radians(np.arange(0, 90, step)):
        turned = xy @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        areas.append(np.prod(np.ptp(turned, axis=0)))
    return min(areas)


def closeness(xy, degrees, *, near=0.05, stray=0.004):
    """Return the closeness criterion of Zhang et al. 2017 for a direction, with trimmed sides."""
    angle = np.radians(degrees)
    total = 0.0
    along = [float(x * np.cos(angle) + y * np.sin(angle)) for x, y in xy]
    across = [float(y * np.cos(angle) - x * np.sin(angle)) for x, y in xy]
    k = int(stray * len(xy))
    sides = [(sorted(values)[k], sorted(values)[len(xy) - 1 - k]) for values in (along, across)]
    for u, v in zip(along, across, strict=True):
        d = min(abs(u - sides[0][0]), abs(sides[0][1] - u), abs(v - sides[1][0]), abs(sides[1][1] - v))
        total += 1 / max(d, near)
    return total


def seen_cylinder(base, height, radius, *, tilt=0.0, lean=0.0, seen_from=0.0, arc=180.0, noise=0.0, seed=0, n=3000):
    """Return points on the side of a leaning cylinder that faces an azimuth; angles in degrees."""
    rng = np.random.default_rng(seed)
    azimuth = np.radians(seen_from + rng.uniform(-arc / 2, arc / 2, n))
    along = rng.uniform(0, height, n)
    far = radius + rng.normal(0, noise, n) if noise else radius
    side = np.column_stack([np.sin(azimuth) * far, np.cos(azimuth) * far, np.zeros(n)])
    slope = np.tan(np.radians(tilt)) * np.array([np.sin(np.radians(lean)), np.cos(np.radians(lean))])
    return side + np.column_stack([along[:, None] * slope, along]) + base


def planted_sign(base, *, facing, bottom=2.2, size=0.7, standoff=0.06, disc=True, seed=0):
    """Return points of a panel and its post, with the panel `standoff` in front of the axis of the post."""
    rng = np.random.default_rng(seed)
    post = seen_cylinder(np.zeros(3), bottom + size, 0.03, seen_from=facing, seed=seed, n=600)
    uv = rng.uniform(-size / 2, size / 2, (1500, 2))
    if disc:
        uv = uv[np.hypot(*uv.T) <= size / 2]
    turn = np.radians(facing)
    normal, right = np.array([np.sin(turn), np.cos(turn), 0]), np.array([np.cos(turn), -np.sin(turn), 0])
    panel = standoff * normal + uv[:, :1] * right + np.array([0, 0, bottom + size / 2]) + uv[:, 1:] * [0, 0, 1]
    return np.concatenate([post[post[:, 2] < bottom], panel + rng.normal(0, 0.003, panel.shape)]) + base
