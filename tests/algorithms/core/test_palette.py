"""Colours: fixed, distinct, and apart under colour blindness."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.core.palette import (
    COLOURS,
    CORRECT_COLOUR,
    IGNORED_COLOUR,
    WRONG_COLOUR,
    class_palette,
    error_colours,
    hex_to_rgb,
)

# Machado et al. 2009, severity 1.0, linear RGB
VISION = {
    "normal": np.eye(3),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
COMPARISONS = [
    ["wire", "utility_pole", "road", "building", "tree", "traffic_sign", "car"],
    ["road", "grass", "tree", "building", "wall", "utility_pole", "bicycle", "car", "bus_shelter", "person"],
    ["road", "grass", "palm", "cycas", "brushwood", "light_pole", "car"],
]


def lab(rgb, vision):
    share = np.asarray(rgb) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ vision.T, 0, 1)
    xyz = seen @ np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]).T
    t = xyz / [0.9505, 1.0, 1.089]
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("names", COMPARISONS, ids=["oakland", "tomic2019", "luo2016"])
def test_classes_of_a_comparison_stay_apart_for_everyone(names, vision):
    colours = lab(class_palette(tuple(names))[:-1], VISION[vision])
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=2)
    distances[np.diag_indices(len(names))] = np.inf
    assert distances.min() > 11, np.array(names)[list(np.unravel_index(distances.argmin(), distances.shape))]


def test_every_taxonomy_class_has_a_colour_of_its_own():
    assert set(COLOURS) == set(TAXONOMY)
    assert len(set(COLOURS.values())) == len(COLOURS)


def test_a_class_takes_the_colour_of_its_name_or_of_its_first_member():
    scheme = ClassScheme(
        "s", ("tree", "things", "pole object"), (("trunk",), ("bin", "bench"), ("wire",)), (), (5, 1, 2)
    )
    palette = class_palette(scheme)
    expected = [COLOURS["tree"], COLOURS["bin"], COLOURS["utility_pole"]]
    assert [tuple(row) for row in palette[:3]] == [hex_to_rgb(colour) for colour in expected]
    assert tuple(palette[-1]) == IGNORED_COLOUR


def test_no_two_classes_share_a_colour_even_if_the_taxonomy_does_not_know_them():
    names = ("vehicle", "car", *(f"class {k}" for k in range(30)))
    assert len(np.unique(class_palette(names), axis=0)) == len(names) + 1


def test_errors_are_red_right_points_grey_and_ignored_ones_light():
    colours = error_colours([0, 1, -1, 1], [0, 0, 1, -1])
    assert [tuple(c) for c in colours] == [CORRECT_COLOUR, WRONG_COLOUR, IGNORED_COLOUR, WRONG_COLOUR]
