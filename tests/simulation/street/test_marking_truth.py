"""True markings of streets: on paint, complete, and of the right kind."""

import numpy as np
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.street.cover import ground_labels
from mlsroad_pipeline.simulation.street.marking_truth import CROSSING, LANE, STOP_LINE, true_markings
from mlsroad_pipeline.simulation.street.street import draw_street


def test_places_are_painted_and_all_paint_is_near_one():
    street = draw_street(3, length=120.0)
    truth = true_markings(street, start=0.0, end=120.0)
    s, left = (part.ravel() for part in np.meshgrid(np.arange(2.0, 118.0, 0.25), np.arange(-20.0, 20.0, 0.05)))
    paint = ground_labels(street.ground, s, left) == TAXONOMY["lane_marking"]
    places = street.alignment.place(s[paint], left[paint])[0]
    known = np.concatenate([truth.places, truth.rest])[:, :2]
    assert paint.sum() > 1000
    assert cKDTree(known).query(places[:, :2])[0].max() < 0.5
    lines = truth.places[truth.kind != CROSSING, :2]
    fine = ground_labels(street.ground, s, left) == TAXONOMY["lane_marking"]
    assert np.mean(cKDTree(street.alignment.place(s[fine], left[fine])[0][:, :2]).query(lines)[0] < 0.3) > 0.5
    for kind in (LANE, STOP_LINE, CROSSING):
        assert (truth.kind == kind).sum() * 0.1 > 5.0
