"""Slow, obvious versions of the ground filter, and a street with known ground."""

import numpy as np
from scipy.spatial import cKDTree


def plain_upward_growing(xyz, *, voxel_size, columns_per_block, local_height, global_height):
    """Grow every voxel of every block upward by following its upper neighbours one by one; True is ground.

    Heights are counted from the lowest point of the block, layers from there.
    """
    index = np.floor((xyz - xyz.min(axis=0))[:, :2] / voxel_size).astype(int)
    blocks = index // columns_per_block
    is_ground = np.zeros(len(xyz), dtype=bool)
    for block in np.unique(blocks, axis=0):
        members = np.flatnonzero((blocks == block).all(axis=1))
        height = xyz[members, 2] - xyz[members, 2].min()
        layer = np.floor(height / voxel_size).astype(int)
        voxels = {(x, y, z) for (x, y), z in zip(index[members].tolist(), layer.tolist(), strict=True)}
        tops = {v: _top_of_region(v, voxels) for v in voxels}
        for row, h, (x, y), z in zip(members, height, index[members].tolist(), layer.tolist(), strict=True):
            top = tops[(x, y, z)]
            low = top <= int(global_height / voxel_size + 1e-6)
            flat = top - z <= int(local_height / voxel_size + 1e-6)
            is_ground[row] = low and flat and h <= global_height
    return is_ground


def _top_of_region(start, voxels):
    region, front = {start}, [start]
    while front:
        x, y, z = front.pop()
        above = {(x + dx, y + dy, z + 1) for dx in (-1, 0, 1) for dy in (-1, 0, 1)} & voxels - region
        region |= above
        front.extend(above)
    return max(z for _, _, z in region)


def keep_inliers(xyz, n_neighbors, std_ratio):
    """Return Open3D's statistical rule, point by point; coinciding points stay."""
    distance, _ = cKDTree(xyz).query(xyz, k=min(n_neighbors, len(xyz)))
    spacing = [float(np.mean(row)) for row in distance]
    mean = sum(spacing) / len(spacing)
    deviation = (sum((s - mean) ** 2 for s in spacing if s > 0) / (len(spacing) - 1)) ** 0.5
    return np.array([s <= mean + std_ratio * deviation for s in spacing])


def street(rng, *, n_ground=40_000, length=40.0, grade=0.06, cross_fall=0.02, noise=0.005):
    """Return points and truth of a street: crown, curbs and pavements on a slope, and what stands on it.

    Objects are sampled on their surfaces: walls, poles, cars standing 0.2 m above a road that is mostly hidden below
    them, crowns behind the walls where no ground is seen at all, and a ledge of a wall without its base.
    """

    def height(x, y):
        crown = -0.025 * np.minimum(np.abs(y), 4.0)
        curb = np.where(np.abs(y) > 4.0, 0.14 + 0.02 * (np.abs(y) - 4.0), 0.0)
        return grade * x + cross_fall * y + crown + curb + 0.3 * np.sin(x / 12.0)

    x, y = rng.uniform(0, length, n_ground), rng.uniform(-8, 8, n_ground)
    ground = np.column_stack([x, y, height(x, y)])
    objects = []
    for cx, cy in ((6.0, 2.8), (14.0, -2.8), (29.0, 2.8)):
        inside = (np.abs(ground[:, 0] - cx) < 2.1) & (np.abs(ground[:, 1] - cy) < 0.85)
        ground = ground[~inside | (rng.random(len(ground)) < 0.1)]
        objects.append(_box(rng, 1500, (cx, cy), (4.2, 1.7), height(cx, cy) + np.array([0.2, 0.8])))
        objects.append(_box(rng, 800, (cx, cy), (2.2, 1.5), height(cx, cy) + np.array([0.8, 1.4])))
    for px, py in ((3.0, 5.0), (18.0, -5.0), (33.0, 5.0)):
        angle, up = rng.uniform(0, 2 * np.pi, 600), rng.uniform(0, 6, 600)
        objects.append(np.column_stack([px + 0.08 * np.cos(angle), py + 0.08 * np.sin(angle), height(px, py) + up]))
    for side in (-1, 1):
        wx, up = rng.uniform(0, length, 12_000), rng.uniform(0, 7, 12_000)
        objects.append(np.column_stack([wx, np.full_like(wx, side * 8.0), height(wx, side * 8.0) + up]))
    crown = rng.normal(size=(4000, 3))
    crown *= (rng.random(len(crown)) ** (1 / 3) * 2.0 / np.linalg.norm(crown, axis=1))[:, None]
    objects.append(crown + np.array([20.0, 12.0, height(20.0, 12.0) + 4.0]))
    lx, up = rng.uniform(0, length, 1500), rng.uniform(1.5, 3, 1500)
    objects.append(np.column_stack([lx, np.full_like(lx, -11.0), height(lx, -11.0) + up]))
    xyz = np.concatenate([ground, *objects])
    truth = np.arange(len(xyz)) < len(ground)
    return xyz + rng.normal(scale=noise, size=xyz.shape), truth


def _box(rng, n, centre, size, z):
    """Sample the sides and the top of a box, which hangs free of the ground."""
    u, v, w = rng.uniform(-0.5, 0.5, n), rng.uniform(-0.5, 0.5, n), rng.uniform(0, 1, n)
    face = rng.integers(0, 5, n)
    u = np.where(face == 0, -0.5, np.where(face == 1, 0.5, u))
    v = np.where(face == 2, -0.5, np.where(face == 3, 0.5, v))
    w = np.where(face == 4, 1.0, w)
    return np.column_stack([centre[0] + u * size[0], centre[1] + v * size[1], z[0] + w * (z[1] - z[0])])
