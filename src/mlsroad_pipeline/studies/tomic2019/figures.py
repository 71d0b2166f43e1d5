"""Figures of the study of Tomic et al. 2019: its Figures 10 to 13 of one survey, and F1 of all classes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.fusion.two_methods import best_labels
from mlsroad_pipeline.algorithms.image_labels.cityscapes import encode_label_image
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import View, birds_eye_view, look_at
from mlsroad_pipeline.studies.figures import draw_bars, draw_panels, legend_below, name_axes
from mlsroad_pipeline.studies.tomic2019.plan import PRINTED, StudyPlan
from mlsroad_pipeline.studies.tomic2019.results import StudyTables, answer_name
from mlsroad_pipeline.studies.tomic2019.scores import FEATURES, IMAGES, POOL, RULE

SKY_COLOUR = (190, 215, 240)
REACH = 25.0
"""Points farther from the middle of the road than this are left out of the clouds, metres."""

Arrays = Mapping[str, NDArray]


def study_figures(
    plan: StudyPlan,
    tables: StudyTables,
    *,
    points: PointCloud,
    images: Arrays,
    features: Arrays,
    through_images: Arrays,
    pixels: Arrays,
    answers: Arrays,
) -> tuple[Figure, ...]:
    """Draw the figures."""
    station = points["station"]
    half, first, second = (plan.division.rows(station, part) for part in ("test", "test1", "test2"))
    truth = plan.scheme.encode(points["label"], source=points.source)
    at = np.searchsorted(half, first)
    labels = best_labels(features["probabilities"][at])
    cameras = list(through_images["cameras"])
    place = cameras.index(str(images["camera"][int(pixels["image"])]))
    seen = best_labels(through_images["probabilities"][place, at])
    near, far = _near(points, first, images), _near(points, second, images)
    return (
        _bars(tables),
        _from_above(plan, points.xyz[first[near]], {"truth": truth[first[near]], "method 1": labels[near]}),
        _facade(plan, points.xyz[first[near]], truth[first[near]], labels[near]),
        _segmented(plan, images, pixels, points.xyz[first], seen),
        _from_above(
            plan, points.xyz[second[far]],
            {"truth": truth[second[far]], **{name: answers[key][far] for name, key in
             (("method 1", FEATURES), ("images", IMAGES), ("fusion", RULE), ("probabilistic fusion", POOL))}},
        ),
    )  # fmt: skip


def _near(points: PointCloud, rows: NDArray[np.int64], images: Arrays) -> NDArray[np.bool_]:
    """Tell which points are near the road: the line along which the cameras went."""
    track = np.stack([-turn.T @ shift for turn, shift in zip(images["R"], images["t"], strict=True)])[:, :2]
    middle = track.mean(axis=0)
    along = np.linalg.svd(track - middle)[2][0]
    away = points.xyz[rows, :2] - middle
    return np.abs(away @ np.array([-along[1], along[0]])) <= REACH


def _from_above(plan: StudyPlan, xyz: NDArray, labels: Mapping[str, NDArray]) -> Figure:
    """Draw labellings of a part of the road seen from above, and where the last one errs."""
    view = birds_eye_view(xyz, width=1400, trim=0.002)
    return _labellings(plan, xyz, labels, view)


def _labellings(plan: StudyPlan, xyz: NDArray, labels: Mapping[str, NDArray], view: View) -> Figure:
    pictures = {
        name: labelling_pictures(xyz, view, classes=plan.scheme, predicted=given, splat_metres=0.12)["prediction"]
        for name, given in labels.items()
    }
    return cloud_figure(pictures, view, classes=plan.scheme)


def _facade(plan: StudyPlan, xyz: NDArray, truth: NDArray, labels: NDArray) -> Figure:
    """Draw the piece of a facade that method 1 takes most for something else (Figure 11)."""
    building = plan.scheme.classes.index("building")
    rows = np.flatnonzero(truth == building)
    wrong = rows[labels[rows] != building] if len(rows) else np.arange(len(xyz))
    shown = wrong if len(wrong) else rows
    cells, counts = np.unique(np.floor(xyz[shown, :2] / 8.0), axis=0, return_counts=True)
    target = np.append((cells[counts.argmax()] + 0.5) * 8.0, np.quantile(xyz[:, 2], 0.05) + 3.0)
    middle = np.median(xyz, axis=0)[:2]
    towards = middle - target[:2]
    side = towards / max(float(np.linalg.norm(towards)), 1e-9)
    eye = target + np.append(side * 16.0, 4.0)
    near = np.linalg.norm(xyz[:, :2] - target[:2], axis=1) <= 14.0
    given = {"truth": truth[near], "method 1": labels[near]}
    return _labellings(plan, xyz[near], given, look_at(eye, target, size=(1100, 700), field_of_view=65.0))


def _segmented(plan: StudyPlan, images: Arrays, pixels: Arrays, xyz: NDArray, seen: NDArray) -> Figure:
    """Draw an image, its classes, the true ones, and what the camera says of the points (Figure 12)."""
    row = int(pixels["image"])
    palette = np.vstack([class_palette(plan.scheme)[:-1], SKY_COLOUR, class_palette(plan.scheme)[-1:]])
    truth = encode_label_image(images["label"][row], plan.scheme)
    given = seen != IGNORE
    view = birds_eye_view(xyz[given], width=1400, trim=0.01) if given.any() else birds_eye_view(xyz, width=1400)
    cloud = labelling_pictures(xyz[given], view, classes=plan.scheme, predicted=seen[given], splat_metres=0.12)
    camera = str(images["camera"][row]).replace("_", " ")
    figure, panels = draw_panels(2, rows=2, width=5.6, height=4.2)
    shown = (
        (images["rgb"][row], f"Image of the {camera} camera"),
        (palette[pixels["segmented"]], "Segmented"),
        (palette[truth], "True classes"),
        (cloud["prediction"], f"Test set 1 through the {camera} camera"),
    )
    for axes, (picture, title) in zip(panels, shown, strict=True):
        axes.imshow(picture)
        axes.set_xticks([])
        axes.set_yticks([])
        name_axes(axes, title=title)
    for name, colour in zip((*plan.scheme.classes, "sky"), palette, strict=False):
        panels[0].plot([], [], "s", color=colour / 255, label=name)
    legend_below(figure, panels[0], 6)
    return figure


def _bars(tables: StudyTables) -> Figure:
    """Draw F1 of the classes on test set 2, the paper's as diamonds."""
    figure, (axes,) = draw_panels(1, width=11, height=4.2)
    shown = {
        PRINTED: tables.table_3, answer_name(IMAGES, ""): tables.table_4,
        answer_name(RULE, PRINTED): tables.table_5, answer_name(POOL, PRINTED): tables.table_5,
    }  # fmt: skip
    rows = {name: table[table["method"] == name].set_index("class") for name, table in shown.items()}
    classes = list(rows[PRINTED].index)
    empty = dict.fromkeys([answer_name(POOL, PRINTED)], np.full(len(classes), np.nan))
    draw_bars(
        axes,
        classes,
        {name: table["f1"] for name, table in rows.items()},
        spread={name: table["f1_spread"] for name, table in rows.items()},
        paper={name: table["paper_f1"].to_numpy() for name, table in rows.items()} | empty,
    )
    axes.tick_params("x", rotation=20)
    name_axes(axes, y="F1 on test set 2 (diamonds: tomic2019)", unit_range="y")
    legend_below(figure, axes, 4)
    return figure
