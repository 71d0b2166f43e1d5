"""Pictures of the benchmark of recordings: truth, prediction and errors from above and from the side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.comparison.recordings.plan import Run, StudyPlan
from mlsroad_pipeline.papers.comparison.recordings.scoring import unmixed
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, build_report

REACH = 50.0
"""Drawn surroundings of the middle of a scene, metres; beyond, points of single scans lie too far apart to see."""


def source_pages(plan: StudyPlan, scenes: SceneCollection, runs: SceneCollection) -> dict[str, str]:
    """Return one HTML page per recording with the pictures of its middle scene for the chosen runs.

    A recording without a chosen run among those that are requested keeps its page.
    """
    asked = {run.key for run in plan.runs()}
    pages = {}
    for name, source in plan.sources.items():
        keys = [f"{method}.{name}" for method in plan.study.pictured if f"{method}.{name}" in runs]
        if not asked & set(keys):
            continue
        stems = list(source.paths(plan.root))
        middle = f"{name}.{stems[len(stems) // 2]}"
        scene = scenes[middle].load()
        sections: list[Section] = [
            FactsSection("Recording", {"scanner": source.scanner, "licence": source.licence, "scene": middle})
        ]
        for key in keys:
            run = Run.parse(key)
            label = runs.part("picture")[key].load()["label"]
            figures = scene_figures(plan, run, scene, label)
            sections.append(FiguresSection(f"{run.method}, {run.protocol}", figures))
        pages[name] = build_report(sections, title=source.title)
    return pages


def scene_figures(
    plan: StudyPlan, run: Run, scene: PointCloud, label: NDArray[np.integer]
) -> Mapping[str, Figure | NDArray[np.uint8]]:
    """Draw truth, prediction and errors of a scene from above and from the side."""
    middle = np.median(scene.xyz[:, :2], axis=0)
    rows = np.flatnonzero(np.abs(scene.xyz[:, :2] - middle).max(axis=1) <= REACH)
    xyz = scene.xyz[rows]
    truth = plan.scheme.encode(scene["label"][rows], source=scene.source)
    predicted = unmixed(truth, label[rows], plan.scheme, plan.sources[run.source].mixed)
    views = {"From above": birds_eye_view(xyz), "From the side": oblique_view(xyz, elevation=8.0)}
    return {
        name: cloud_figure(
            labelling_pictures(xyz, view, classes=plan.scheme, truth=truth, predicted=predicted),
            view, classes=plan.scheme, present=np.concatenate([truth, predicted]), title=name,
        )
        for name, view in views.items()
    }  # fmt: skip
