"""True markings of streets: on paint, complete, and of the right kind."""

import numpy as np
from references.simulator import ground_labels
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.street.line_truth import CROSSING, LANE, STEP, STOP_LINE, true_markings
from mlsroad_pipeline.simulation.street.street import draw_street

START, END = 2.0, 118.0


def test_places_are_painted_and_lines_are_complete():
    street = draw_street(3, length=120.0)
    truth = true_markings(street, start=0.0, end=120.0)
    s, left = np.meshgrid(np.arange(START, END, STEP), np.arange(-7.0, 7.0, 0.05))
    paint = ground_labels(street.ground, s.ravel(), left.ravel()).reshape(s.shape) == TAXONOMY["lane_marking"]
    painted = cKDTree(street.alignment.place(s[paint], left[paint])[0][:, :2])
    lines = truth.places[truth.kind != CROSSING, :2]
    inside = lines[cKDTree(street.alignment.place(s.ravel(), left.ravel())[0][:, :2]).query(lines)[0] < 0.05]
    assert len(inside) > 3000 and painted.query(inside)[0].max() < 0.1
    # Paint along the road for more than a fifth of it, outside crossings, is a line.
    for at, half in street.ground.crossings:
        paint[:, np.abs(s[0] - at) < half + 0.2] = False
    rows = np.flatnonzero(paint.mean(axis=1) > 0.2)
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    assert len(groups) == 5  # two edges, the middle, and a dashed line on either side
    lanes = cKDTree(truth.places[truth.kind == LANE, :2])
    for group in groups:
        row = group[len(group) // 2]
        places = street.alignment.place(s[row][paint[row]], left[row][paint[row]])[0][:, :2]
        assert np.mean(lanes.query(places)[0] < 0.15) > 0.96, left[row, 0]
    for kind in (LANE, STOP_LINE, CROSSING):
        assert (truth.kind == kind).sum() * STEP > 5.0
