"""Figures of the study of Tomic et al. 2019: F1 of all classes, and Figures 10 to 13 for the first survey."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.cityscapes import encode_label_image
from mlsroad_pipeline.algorithms.core.classes import IGNORE
from mlsroad_pipeline.algorithms.core.palette import class_palette
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.studies.study import Tables, draw_bars, draw_panels, legend_below, name_axes
from mlsroad_pipeline.papers.tomic2019.fusion.two_methods import best_labels
from mlsroad_pipeline.papers.tomic2019.study.plan import PRINTED, StudyPlan
from mlsroad_pipeline.papers.tomic2019.study.scores import FEATURES, IMAGES, POOL, RULE, method_name
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import View, birds_eye_view, look_at

SKY_COLOUR = (190, 215, 240)
REACH = 25.0
"""Largest distance of drawn points from the middle of the road, metres."""

CAPTIONS = {
    "f1": "F1 of the classes on test set 2, mean and spread over the surveys",
    "figure_10": "Figure 10: method 1 as printed on test set 1 of the first survey, from above",
    "figure_11": "Figure 11: part of a facade with most errors of method 1",
    "figure_12": "Figure 12: an image, its segmentation, and the labels of test set 1 through its camera",
    "figure_13": "Figure 13: test set 2 of the first survey, from above",
}
"""Name of each figure to its caption."""

Arrays = Mapping[str, NDArray]


def study_figures(
    tables: Tables,
    plan: StudyPlan,
    streets: SceneCollection,
    by_features: SceneCollection,
    by_images: SceneCollection,
    runs: SceneCollection,
) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    street = plan.streets[0]
    key = f"{PRINTED}.{street}"
    points, images = (streets.part(part)[street].load() for part in ("points", "images"))
    through_images, pixels = (by_images.part(part)[street].load() for part in ("labels", "pixels"))
    features, fused = by_features.part("labels")[key].load(), runs.part("answers")[key].load()
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
            {"truth": truth[second[far]], **{name: fused[labelling][far] for name, labelling in
             (("method 1", FEATURES), ("images", IMAGES), ("fusion", RULE), ("probabilistic fusion", POOL))}},
        ),
    )  # fmt: skip


def _near(points: PointCloud, rows: NDArray[np.int64], images: Arrays) -> NDArray[np.bool_]:
    """Return which points are near the road, a straight line through the camera positions."""
    track = np.stack([-turn.T @ shift for turn, shift in zip(images["R"], images["t"], strict=True)])[:, :2]
    middle = track.mean(axis=0)
    along = np.linalg.svd(track - middle)[2][0]
    away = points.xyz[rows, :2] - middle
    return np.abs(away @ np.array([-along[1], along[0]])) <= REACH


def _from_above(plan: StudyPlan, xyz: NDArray, labels: Mapping[str, NDArray]) -> Figure:
    """Draw labellings of a part of the road from above."""
    view = birds_eye_view(xyz, width=1400, trim=0.002)
    return _labellings(plan, xyz, labels, view)


def _labellings(plan: StudyPlan, xyz: NDArray, labels: Mapping[str, NDArray], view: View) -> Figure:
    pictures = {
        name: labelling_pictures(xyz, view, classes=plan.scheme, predicted=label, splat_metres=0.12)["prediction"]
        for name, label in labels.items()
    }
    return cloud_figure(pictures, view, classes=plan.scheme)


def _facade(plan: StudyPlan, xyz: NDArray, truth: NDArray, labels: NDArray) -> Figure:
    """Draw the part of a facade where method 1 has most errors (Figure 11)."""
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
    shown_labels = {"truth": truth[near], "method 1": labels[near]}
    return _labellings(plan, xyz[near], shown_labels, look_at(eye, target, size=(1100, 700), field_of_view=65.0))


def _segmented(plan: StudyPlan, images: Arrays, pixels: Arrays, xyz: NDArray, seen: NDArray) -> Figure:
    """Draw an image, its segmentation, its true classes, and the labels of points through its camera (Figure 12)."""
    row = int(pixels["image"])
    palette = np.vstack([class_palette(plan.scheme)[:-1], SKY_COLOUR, class_palette(plan.scheme)[-1:]])
    truth = encode_label_image(images["label"][row], plan.scheme)
    visible = seen != IGNORE
    view = birds_eye_view(xyz[visible], width=1400, trim=0.01) if visible.any() else birds_eye_view(xyz, width=1400)
    cloud = labelling_pictures(xyz[visible], view, classes=plan.scheme, predicted=seen[visible], splat_metres=0.12)
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


def _bars(tables: Tables) -> Figure:
    """Draw F1 of the classes on test set 2, with the paper's values as diamonds."""
    figure, (axes,) = draw_panels(1, width=11, height=4.2)
    shown = {
        PRINTED: tables["table_3"], method_name(IMAGES, ""): tables["table_4"],
        method_name(RULE, PRINTED): tables["table_5"], method_name(POOL, PRINTED): tables["table_5"],
    }  # fmt: skip
    rows = {name: table[table["method"] == name].set_index("class") for name, table in shown.items()}
    classes = list(rows[PRINTED].index)
    empty = dict.fromkeys([method_name(POOL, PRINTED)], np.full(len(classes), np.nan))
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
