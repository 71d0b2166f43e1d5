"""Separation of plates from masts by contrast, or as thin sheets."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.segmentation.normalized_cut import NormalizedCutParameters, segment


def lamp(rng, height=8.0, radius=0.08, lean=0.0):
    angle, z = rng.uniform(0, 2 * np.pi, 8000), rng.uniform(0, height, 8000)
    mast = np.column_stack([radius * np.cos(angle) + lean * z, radius * np.sin(angle), z])
    arm = np.column_stack([rng.uniform(0, 1.5, 600) + lean * height, rng.normal(0, 0.02, 600), np.full(600, height)])
    return np.concatenate([mast, arm])


def plate(rng, low, high, *, left=-0.35, right=0.35, front=0.1, n=1500):
    return np.column_stack([rng.uniform(left, right, n), np.full(n, front), rng.uniform(low, high, n)])


def found_with(rng, bodies, brightness, **changes):
    parts = [lamp(rng), *bodies]
    truth = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    intensity = None if brightness is None else np.append(0.4, brightness)[truth]
    objects = segment(np.concatenate(parts), intensity=intensity, parameters=NormalizedCutParameters(**changes))
    return objects, truth


@pytest.mark.parametrize("front", [0.1, 0.0])
def test_bright_plate_on_a_mast_is_an_object_of_its_own(front, rng):
    objects, truth = found_with(rng, [plate(rng, 2.4, 3.1, front=front)], [0.6])
    assert objects.max() == 1
    sign = objects == np.bincount(objects[truth == 1]).argmax()
    overlap = (sign & (truth == 1)).sum() / (sign | (truth == 1)).sum()
    assert overlap > 0.7


def test_all_plates_of_a_mast_are_one_sign(rng):
    objects, truth = found_with(rng, [plate(rng, 2.2, 2.8), plate(rng, 3.6, 4.2)], [0.6, 0.6])
    assert objects.max() == 1
    sign = objects == np.bincount(objects[truth > 0]).argmax()
    assert (sign & (truth > 0)).sum() / (sign | (truth > 0)).sum() > 0.7


def test_a_thin_sheet_is_separated_without_contrast_and_a_box_is_not(rng):
    back = plate(rng, 2.4, 3.1)
    assert found_with(rng, [back], [0.39])[0].max() == 1
    assert found_with(rng, [back], None)[0].max() == 1
    box = rng.uniform([-0.35, 0.0, 2.4], [0.35, 0.3, 3.1], (6000, 3))
    assert found_with(rng, [box], [0.39])[0].max() == 0
    crowded = plate(rng, 6.0, 6.9)  # too high to be a plate itself, and close above one
    assert found_with(rng, [plate(rng, 5.0, 5.4, left=-0.5, right=0.3), crowded], [0.39, 0.39])[0].max() == 0


@pytest.mark.parametrize(
    ("body", "brightness", "changes"),
    [
        ((2.4, 3.1), 0.34, {}),  # duller than the mast: no sheeting, nor its back
        ((2.4, 2.8), 0.4, {"plate_gap": 6.0}),
        ((2.4, 3.6), 0.4, {}),  # as bright as the mast and higher than signs are: a banner
        ((2.4, 3.6), None, {}),  # without intensities nothing tells it from a banner
        ((2.4, 3.1), 0.6, {"plate_gap": 0.0}),
        ((2.4, 3.1), 0.6, {"plate_gap": 6.0}),  # the mast does not go on that far
        ((7.2, 7.9), 0.6, {}),  # a sign ends with its plate
        ((2.4, 2.5), 0.6, {}),  # an arm is no plate
    ],
)
def test_other_fixtures_stay_on_the_mast(body, brightness, changes, rng):
    objects, _ = found_with(rng, [plate(rng, *body)], None if brightness is None else [brightness], **changes)
    assert objects.max() == 0


def test_negative_length_is_an_error():
    with pytest.raises(ParameterError, match="plate_gap"):
        NormalizedCutParameters(plate_gap=-0.1)
