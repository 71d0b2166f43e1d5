"""Contents of figures against their data."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.palette import CORRECT_COLOUR, WRONG_COLOUR, class_palette
from mlsroad_pipeline.algorithms.metrics.scores import labelling_scores
from mlsroad_pipeline.reporting.clouds import cloud_figures
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view, scale_length
from mlsroad_pipeline.reporting.figures import class_bars_figure, confusion_figure, importance_figure, oob_figure

MATRIX = np.array([[8, 2, 0], [0, 9, 1], [0, 0, 0]])
CLASSES = ("road", "car", "wire")


def texts(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_confusion_figure_writes_shares_and_counts():
    figure = confusion_figure(MATRIX, classes=CLASSES)
    assert texts(figure) == ["80.0", "8", "20.0", "2", "90.0", "9", "10.0", "1"]
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["road (10)", "car (10)", "wire (0)"]


@pytest.mark.parametrize(("unlabelled", "columns"), [(0, 3), (4, 4)])
def test_confusion_figure_shows_unlabelled_points_only_where_there_are_any(unlabelled, columns):
    matrix = np.column_stack([MATRIX, [unlabelled, 0, 0]])
    names = [label.get_text() for label in confusion_figure(matrix, classes=CLASSES).axes[0].get_xticklabels()]
    assert len(names) == columns
    assert ("unlabelled" in names) == (unlabelled > 0)


def test_class_bars_are_as_high_as_the_scores_and_undefined_ones_are_dashes():
    frame = labelling_scores(MATRIX, method="m", split="test", classes=CLASSES)
    figure = class_bars_figure(frame, split="test")
    recall = [bar.get_height() for bar in figure.axes[1].patches]
    assert recall == [0.8, 0.9, 0.0]
    assert [text.get_text() for text in figure.axes[1].texts] == ["0.80", "0.90", "–"]


def test_class_bars_of_two_methods_have_a_legend_and_a_bar_each():
    frame = pd.concat([labelling_scores(MATRIX, method=m, split="test", classes=CLASSES) for m in ("one", "two")])
    figure = class_bars_figure(frame, split="test")
    assert [text.get_text() for text in figure.legends[0].texts] == ["one", "two"]
    assert len(figure.axes[0].patches) == 6


def test_importances_are_sorted_and_cut():
    figure = importance_figure([0.1, 0.6, 0.3], names=["a_b", "c", "d"], largest=2)
    assert [bar.get_width() for bar in figure.axes[0].patches] == [0.6, 0.3]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["c", "d"]
    assert "2 largest of 3" in figure.axes[0].get_title(loc="left")


def test_oob_curve_is_in_per_cent_and_marks_the_choice():
    figure = oob_figure([10, 20], [0.2, 0.1], chosen=20)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), [20, 10])
    assert texts(figure) == ["20 trees"]


@pytest.mark.parametrize(("metres", "length"), [(1.0, 1), (4.9, 2), (5.0, 5), (73, 50), (0.3, 0.2), (1000, 1000)])
def test_scale_bars_have_round_lengths(metres, length):
    assert scale_length(metres) == pytest.approx(length)


@pytest.fixture
def scene(rng):
    xyz = np.column_stack([rng.random((3000, 2)) * [20, 5], np.zeros(3000)])
    truth = (xyz[:, 0] > 10).astype(int)
    return xyz, truth


def test_pictures_show_truth_prediction_and_errors_of_the_same_points(scene):
    xyz, truth = scene
    view = birds_eye_view(xyz, width=120, azimuth=0.0)
    predicted = np.zeros_like(truth)
    pictures = labelling_pictures(xyz, view, classes=CLASSES, truth=truth, predicted=predicted, splat_metres=0.5)
    middle = view.size[1] // 2
    palette = class_palette(CLASSES)
    left, right = (middle, 30), (middle, 90)
    assert list(pictures) == ["truth", "prediction", "errors"]
    np.testing.assert_array_equal(pictures["truth"][left], palette[0])
    np.testing.assert_array_equal(pictures["truth"][right], palette[1])
    np.testing.assert_array_equal(pictures["prediction"][right], palette[0])
    np.testing.assert_array_equal(pictures["errors"][left], CORRECT_COLOUR)
    np.testing.assert_array_equal(pictures["errors"][right], WRONG_COLOUR)


def test_what_is_seen_is_found_once_for_all_methods_and_anew_for_other_points_and_views(scene, monkeypatch):
    xyz, truth = scene
    views = [birds_eye_view(xyz, width=120), oblique_view(xyz, size=(80, 60))]
    found = []
    looked = cloud_figures.nearest_points
    monkeypatch.setattr(cloud_figures, "nearest_points", lambda *a, **k: found.append(1) or looked(*a, **k))
    cloud_figures._LAST_SEEN.clear()
    first = [labelling_pictures(xyz, view, classes=CLASSES, predicted=truth) for view in views]
    assert len(found) == 2
    again = [labelling_pictures(xyz.copy(), view, classes=CLASSES, predicted=truth) for view in views]
    assert len(found) == 2
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one["prediction"], other["prediction"])
    moved = labelling_pictures(xyz + [1.0, 0.0, 0.0], views[0], classes=CLASSES, predicted=truth)
    assert len(found) == 3 and (moved["prediction"] != first[0]["prediction"]).any()
    labelling_pictures(xyz, views[0], classes=CLASSES, predicted=truth, splat_metres=0.2)
    assert len(found) == 4 and len(cloud_figures._LAST_SEEN) == cloud_figures._VIEWS_KEPT == 2


def test_cloud_figure_has_a_scale_bar_in_plan_and_none_in_perspective(scene):
    xyz, truth = scene
    for view, expected in ((birds_eye_view(xyz, width=120), ["2 m"]), (oblique_view(xyz, size=(80, 60)), [])):
        pictures = labelling_pictures(xyz, view, classes=CLASSES, predicted=truth, oversampling=1)
        figure = cloud_figure(pictures, view, classes=CLASSES, present=truth, title="A street")
        assert isinstance(figure, Figure)
        assert texts(figure) == expected
        assert [text.get_text() for text in figure.legends[0].texts] == ["road", "car", "ignored"]


@pytest.mark.parametrize("n_classes", [2, 10, 25])
def test_legends_lie_within_the_figure_and_apart(n_classes):
    names = tuple(f"class {k}" for k in range(n_classes))
    pictures = dict.fromkeys(("truth", "prediction", "errors"), np.zeros((90, 120, 3), np.uint8))
    figure = cloud_figure(pictures, birds_eye_view(np.eye(3)), classes=names, title="Many classes")
    figure.canvas.draw()
    classes, errors = (legend.get_window_extent() for legend in figure.legends)
    assert classes.y0 > errors.y1 - 3 and errors.y0 >= 0 and classes.y1 <= figure.bbox.height


def test_real_street_fills_its_picture(real_data):
    path = real_data("oakland", "oakland_part3_ak.xyz_label_conf.gz")
    xyz = pd.read_csv(path, sep=" ", comment="#", header=None, usecols=[0, 1, 2]).to_numpy()
    view = birds_eye_view(xyz, width=400, trim=0.002)
    picture = labelling_pictures(xyz, view, classes=("road",), predicted=np.zeros(len(xyz), int), splat_metres=0.15)
    painted = (picture["prediction"] != 255).any(axis=2)
    assert 0.1 < painted.mean() < 0.9
    assert painted[:, :40].any()
    assert painted[:, -40:].any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: class_bars_figure(labelling_scores(MATRIX, method="m", split="s", classes=CLASSES), split="t"),
            r"no scores per class of split 't' \(splits: \['s'\]\)",
        ),
        (
            lambda: labelling_pictures(np.zeros((1, 3)), birds_eye_view(np.zeros((1, 3))), classes=CLASSES, truth=[3]),
            r"truth labels must be in -1..2, got 3..3",
        ),
    ],
)
def test_what_cannot_be_drawn_is_named(call, message):
    with pytest.raises(DataError, match=message):
        call()
