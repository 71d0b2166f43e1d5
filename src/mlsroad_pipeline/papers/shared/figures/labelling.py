"""Figures of labelled scenes and of their scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.shared.evaluation.labelling import coarse_labels
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import View, birds_eye_view, oblique_view
from mlsroad_pipeline.reporting.figures.scores import class_bars_figure, confusion_figure


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
