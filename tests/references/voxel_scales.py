"""Slow multi-scale voxel features: loops over voxels, sets of occupied cells, `numpy.linalg`."""

import numpy as np


class Voxels:
    """Voxels of 0.2 m as dictionaries from index to points."""

    def __init__(self, xyz, height, intensity=None, size=0.2):
        self.size = size
        local = xyz - xyz.min(axis=0)
        index = [tuple(row) for row in np.floor(local / size).astype(int).tolist()]
        self.names = sorted(set(index))
        self.points = {v: np.flatnonzero([i == v for i in index]) for v in self.names}
        self.place = {v: local[p].mean(axis=0) for v, p in self.points.items()}
        self.thickness = {v: np.ptp(local[p, 2]) for v, p in self.points.items()}
        self.height = {v: np.where(np.isnan(height[p]), 0, height[p]).mean() for v, p in self.points.items()}
        self.ranks = None
        if intensity is not None:
            share = np.array([((intensity < i).sum() + (intensity == i).sum() / 2) / len(intensity) for i in intensity])
            self.ranks = {v: share[p] for v, p in self.points.items()}

    def cell(self, v, level):
        return tuple(i >> level for i in v)

    def near(self, v, level, reach, axes=(0, 1, 2), same=()):
        """Return the voxels whose cells are within reach along some axes and equal along others."""
        own = self.cell(v, level)
        return [
            u
            for u in self.names
            if all(abs(self.cell(u, level)[a] - own[a]) <= reach for a in axes)
            and all(self.cell(u, level)[a] == own[a] for a in same)
        ]

    def describe(self, v):
        """Return name to value for one voxel."""
        out = {"height": self.height[v], "count": np.log2(len(self.points[v])), "thickness": self.thickness[v]}
        out["intensity"] = np.nan if self.ranks is None else self.ranks[v].mean()
        out["intensity_max"] = np.nan if self.ranks is None else self.ranks[v].max()
        for level in range(5):
            out |= {f"{name}_s{level}": value for name, value in self._level(v, level).items()}
        for level, reach in ((4, 1), (5, 1), (5, 3)):
            out |= {f"wide_{level}_{reach}_{name}": value for name, value in self._wide(v, level, reach).items()}
        return out

    def _level(self, v, level):
        size, near = self.size * 2**level, self.near(v, level, 1)
        places = np.array([self.place[u] for u in near])
        covariance = np.cov(places.T, bias=True) if len(near) > 1 else np.zeros((3, 3))
        values, vectors = np.linalg.eigh(covariance)
        s3, s2, s1 = np.sqrt(np.maximum(values, 0)) + 1e-6
        out = {"linearity": (s1 - s2) / s1, "planarity": (s2 - s3) / s1, "scattering": s3 / s1}
        out |= {"normal_z": abs(vectors[2, 0]), "main_z": abs(vectors[2, 2])}
        out = {name: value if len(near) >= 3 else np.nan for name, value in out.items()}
        wide, narrow = _in_plan(places)
        offset = self.place[v] - places.mean(axis=0)
        out |= {"longest": s1 / size, "shortest": s3 / size, "spread_z": places[:, 2].std() / size}
        out |= {"spread_wide": wide / size, "spread_narrow": narrow / size, "number": np.log2(len(near))}
        out |= {"offset_z": offset[2] / size, "offset_plan": np.hypot(*offset[:2]) / size}
        if level in (1, 3):
            ranks = [np.nan if self.ranks is None else self.ranks[u].mean() for u in near]
            out |= {"intensity_mean": np.mean(ranks), "intensity_spread": np.std(ranks)}
        if level in (1, 2, 3):
            flat = self.near(v, level, 1, axes=(0, 1), same=(2,))
            wide, narrow = _in_plan(np.array([self.place[u] for u in flat]))
            out |= {"slice_wide": wide / size, "slice_narrow": narrow / size, "slice_number": np.log2(len(flat))}
        return out | (self._run(v, level) if level in (1, 2) else {}) | (self._column(v, level) if level else {})

    def _run(self, v, level):
        column = self.near(v, level, 0, axes=(0, 1))
        layers = sorted({self.cell(u, level)[2] for u in column})
        heights = {k: [self.height[u] for u in column if self.cell(u, level)[2] == k] for k in layers}
        runs = [[layers[0]]]
        for k in layers[1:]:
            if k - runs[-1][-1] <= 2:
                runs[-1].append(k)
            else:
                runs.append([k])
        (i,) = [i for i, run in enumerate(runs) if self.cell(v, level)[2] in run]
        bottom, top = min(heights[runs[i][0]]), max(heights[runs[i][-1]])
        above = min(heights[runs[i + 1][0]]) - top if i + 1 < len(runs) else np.nan
        below = bottom - max(heights[runs[i - 1][-1]]) if i > 0 else np.nan
        fill = len(runs[i]) / (runs[i][-1] - runs[i][0] + 1)
        out = {"run_bottom": bottom, "run_top": top, "run_length": top - bottom, "run_fill": fill}
        return out | {"gap_above": above, "gap_below": below}

    def _column(self, v, level):
        own = [self.height[u] for u in self.near(v, level, 0, axes=(0, 1))]
        near = self.near(v, level, 1, axes=(0, 1))
        heights, h = [self.height[u] for u in near], self.height[v]
        out = {"to_top": max(own) - h, "to_bottom": h - min(own)}
        out |= {"to_top_near": max(heights) - h, "to_bottom_near": h - min(heights)}
        return out | ({"relief": self.place[v][2] - min(self.place[u][2] for u in near)} if level in (3, 4) else {})

    def _wide(self, v, level, reach):
        heights = np.array([self.height[u] for u in self.near(v, level, reach, axes=(0, 1))])
        counts = np.bincount(np.searchsorted([0.3, 1, 2, 4, 8], heights, side="right"), minlength=6)
        out = {"band_0": counts[0] / len(heights)}
        out |= {f"band_{b}": counts[b] / max(counts[1:].sum(), 1) for b in range(1, 6)}
        top = heights.max()
        return out | {"top": top, "height_by_top": self.height[v] / max(top, 0.5), "number": np.log2(len(heights))}


def _in_plan(places):
    values = np.linalg.eigvalsh(np.cov(places[:, :2].T, bias=True)) if len(places) > 1 else np.zeros(2)
    narrow, wide = np.sqrt(np.maximum(values, 0))
    return wide, narrow
