"""Figures of labelled scenes, of detections and of their scores."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.detection.scoring import DetectionParameters, detection_outcomes
from mlsroad_pipeline.papers.shared.detection.types import Detections, Segments
from mlsroad_pipeline.papers.shared.evaluation import coarse_labels
from mlsroad_pipeline.reporting.clouds.cloud_figures import INK, cloud_figure, detection_pictures, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import View, birds_eye_view, oblique_view
from mlsroad_pipeline.reporting.figures import SERIES, class_bars_figure, confusion_figure, empty_figure, tidy_axes


def scene_figures(
    scenes: Sequence[PointCloud],
    labels: Sequence[Mapping[str, NDArray]],
    *,
    trained: ClassScheme,
    scored: ClassScheme,
    title: str,
) -> dict[str, Figure]:
    """Draw truth, prediction and errors of neighbouring scenes in bird's-eye and oblique view."""
    origin = scenes[0].origin
    xyz = np.concatenate([scene.moved_to(origin).xyz[scene["core"]] for scene in scenes])
    truth = np.concatenate([scored.encode(s["label"][s["core"]], source=s.source) for s in scenes])
    predicted = np.concatenate(
        [coarse_labels(mine["label"][s["core"]], trained, scored) for s, mine in zip(scenes, labels, strict=True)]
    )
    views = {"birds_eye": birds_eye_view(xyz), "perspective": oblique_view(xyz)}

    def paint(view: View) -> dict[str, NDArray[np.uint8]]:
        return labelling_pictures(xyz, view, classes=scored, truth=truth, predicted=predicted)

    with ThreadPoolExecutor(len(views)) as pool:
        painted = list(pool.map(paint, views.values()))
    return {
        name: cloud_figure(pictures, view, classes=scored, present=truth, title=title)
        for (name, view), pictures in zip(views.items(), painted, strict=True)
    }


def score_figures(
    matrices: Mapping[str, NDArray[np.int64]], table: pd.DataFrame, *, method: str, scheme: ClassScheme
) -> tuple[Figure, Figure]:
    """Draw the confusion matrix and the scores per class of the last split."""
    split = list(matrices)[-1]
    title = f"{method}, split {split}"
    return (
        confusion_figure(matrices[split], classes=scheme.classes, title=title),
        class_bars_figure(table, split=split, title=title),
    )


Curve = tuple[NDArray, NDArray, NDArray]


def precision_recall_figure(curves: Mapping[str, Curve], *, title: str) -> Figure:
    """Draw the precision-recall curve of each class."""
    figure = empty_figure(5.2, 4.2)
    axes = figure.add_subplot()
    for number, (name, (_, precision, recall)) in enumerate(curves.items()):
        colour = SERIES[number % len(SERIES)]
        axes.plot(recall, precision, drawstyle="steps-post", color=colour, linewidth=1.6, label=name)
        if len(recall):
            axes.plot(recall[-1:], precision[-1:], "o", color=colour, markersize=4)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="Recall", ylabel="Precision")
    axes.set_title(title, fontsize=10, color=INK, loc="left")
    axes.grid(color="#e3e6eb", linewidth=0.6)
    tidy_axes(axes)
    if curves:
        axes.legend(fontsize=8, frameon=False, loc="lower left")
    else:
        axes.text(0.5, 0.5, "no reference objects in this split", ha="center", transform=axes.transAxes, color=INK)
    return figure


def detection_figure(
    scenes: Sequence[PointCloud],
    objects: Sequence[Segments],
    detections: Sequence[Detections],
    *,
    scheme: ClassScheme,
    parameters: DetectionParameters,
    title: str,
) -> Figure:
    """Draw reference objects and detections of neighbouring scenes in oblique view."""
    origin = scenes[0].origin
    xyz = np.concatenate([scene.moved_to(origin).xyz[scene["core"]] for scene in scenes])
    results = [
        detection_outcomes(scene, own, made, scheme=scheme, parameters=parameters)
        for scene, own, made in zip(scenes, objects, detections, strict=True)
    ]
    truth, outcomes = (
        np.concatenate([values[k][scene["core"]] for scene, values in zip(scenes, results, strict=True)])
        for k in (0, 1)
    )
    names, view = tuple(parameters.classes), oblique_view(xyz)
    pictures = detection_pictures(xyz, view, classes=names, truth=truth, outcomes=outcomes)
    return cloud_figure(pictures, view, classes=names, present=truth, title=title)
