import numpy as np
import pytest

from mlsroad_pipeline.algorithms.geometry import polyline

LINES = {
    "one segment": [[0, 0], [3, 1]],
    "closed square, chord of length 0": [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]],
    "there and back on the same segments": [[k, 0] for k in range(40)] + [[k, 0] for k in range(38, -1, -1)],
    "spiral": [[0.1 * k * np.cos(k / 5), 0.1 * k * np.sin(k / 5)] for k in range(300)],
    "slanted": [[0.05 * k, 0.05 * k] for k in range(1000)],
}


@pytest.mark.parametrize("name", LINES)
def test_pruning_changes_no_bit(name, rng):
    vertices = np.array(LINES[name], dtype=np.float64) + 1e5
    points = rng.uniform(vertices.min(axis=0) - 20, vertices.max(axis=0) + 20, (2000, 2))
    points[::4] = np.round(points[::4])  # places as far from several segments
    station = np.append(0.0, np.cumsum(np.hypot(*np.diff(vertices, axis=0).T)))
    capsules = polyline.build_capsules(vertices)
    everywhere = capsules.copy()
    everywhere[:, 5] = np.inf  # all segments are compared
    expected = polyline.locate(points, vertices, station, everywhere)
    np.testing.assert_array_equal(polyline.locate(points, vertices, station, capsules), expected)


def test_capsules_hold_their_segments(rng):
    vertices = rng.normal(size=(38, 2)).cumsum(axis=0)
    capsules = polyline.build_capsules(vertices)
    n_leaves = len(capsules) // 2
    for node in range(1, len(capsules)):
        level = int(np.log2(node))
        width = 4 * n_leaves // 2**level
        start = (node - 2**level) * width
        inside = vertices[start : start + width + 1] if start < 37 else vertices[:0]
        if not len(inside):
            assert capsules[node, 0] > 1e200 and capsules[node, 5] == 0
            continue
        a, e = inside[0], inside[-1] - inside[0]
        t = np.clip((inside - a) @ e / (e @ e), 0, 1)
        farthest = np.hypot(*(inside - a - t[:, None] * e).T).max()
        assert capsules[node, 5] == pytest.approx(farthest + 1e-6, abs=1e-9)
