"""Benchmark of labellers on recordings as a study: report, summary, text table and pictures."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.methods import methods_of
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.comparison.recordings import plan as stages
from mlsroad_pipeline.papers.comparison.recordings.parameters import PROTOCOLS
from mlsroad_pipeline.papers.comparison.recordings.results import shown_rows, study_tables
from mlsroad_pipeline.papers.comparison.recordings.scoring import unmixed
from mlsroad_pipeline.papers.shared.studies import study as studies
from mlsroad_pipeline.reporting.clouds.cloud_figures import cloud_figure, labelling_pictures
from mlsroad_pipeline.reporting.clouds.view import birds_eye_view, oblique_view
from mlsroad_pipeline.reporting.html.report import build_report, facts_section, figures_section

CAPTIONS = {"mean_iou": "Mean IoU of each run by recording"}
"""Name of each figure to its caption."""

NOTE = (
    "Means are over the classes that the recording has, without the class other. Runs whose training data hold a part "
    "of the recording (own, own_and_simulated) are scored on its test part, the others on all points. The pool has "
    "trees of the protocol and, in all protocols, the network of the package. Recordings that this network has "
    "learned from are scored with the shipped model alone."
)
_FIGURES = {
    "overall_accuracy": "overall accuracy",
    "mean_iou": "mean IoU",
    "mean_f1": "mean F1",
    "calibration_error": "expected calibration error",
    "auroc": "AUROC",
    "seconds_per_million": "s per million points",
    "cpu_seconds_per_million": "CPU s per million points",
}


def study_figures(tables: studies.Tables) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    shown = shown_rows(tables["benchmark"])
    names = shown["method"] + ", " + shown["protocol"]
    wide = shown.assign(run=names).pivot(index="source", columns="run", values="mean_iou")
    wide = wide.reindex(index=list(dict.fromkeys(shown["source"])), columns=list(dict.fromkeys(names)))
    figure, (axes,) = studies.draw_panels(1, width=13, height=4.2)
    studies.draw_bars(axes, list(wide.index), {str(run): wide[run].to_numpy() for run in wide.columns})
    studies.name_axes(axes, y="Mean IoU", unit_range="y")
    studies.legend_below(figure, axes, 4)
    return (figure,)


def study_facts(plan: stages.StudyPlan) -> dict[str, Any]:
    """Return the classes and how means are taken."""
    return {"class scheme": plan.scheme.name, "means": NOTE}


def study_page(plan: stages.StudyPlan, tables: studies.Tables) -> list[studies.Shown]:
    """Return the tables of the page."""
    shown = shown_rows(tables["benchmark"])
    sources = pd.DataFrame(
        [
            {"recording": s.title, "scanner": s.scanner, "licence": s.licence, "classes": ", ".join(s.classes)}
            for s in plan.sources.values()
        ]
    )
    return [
        studies.Shown("Recordings", sources),
        studies.Shown("Mean IoU", mean_table(plan, shown).round(3)),
        *(
            studies.Shown(source.title, _of_source(shown, name).round(3))
            for name, source in plan.sources.items()
            if name in set(shown["source"])
        ),
    ]


def _of_source(shown: pd.DataFrame, name: str) -> pd.DataFrame:
    own = shown[shown["source"] == name].dropna(axis=1, how="all")
    overall = own[["method", "protocol", *(c for c in _FIGURES if c in own)]].rename(columns=_FIGURES)
    per_class = own[[c for c in own if str(c).startswith("iou_")]]
    per_class = per_class.rename(columns=lambda c: f"IoU {str(c).removeprefix('iou_')}")
    return pd.concat([overall, per_class], axis=1)


def mean_table(plan: stages.StudyPlan, shown: pd.DataFrame) -> pd.DataFrame:
    """Return the mean IoU of each method and protocol, one column per recording."""
    wide = shown.pivot(index=["method", "protocol"], columns="source", values="mean_iou")
    names = [name for name in plan.sources if name in wide]
    wide = wide[names].reset_index()
    order = wide["protocol"].map(PROTOCOLS.index)
    wide = wide.assign(order=order).sort_values(["order", "method"]).drop(columns="order")
    titles = {name: plan.sources[name].title for name in names}
    return wide.rename(columns=titles).rename_axis(columns=None).reset_index(drop=True)


def markdown_tables(plan: stages.StudyPlan, benchmark: pd.DataFrame) -> str:
    """Return Markdown tables: mean IoU of all runs, and the IoU per class of each recording."""
    shown = shown_rows(benchmark)
    parts = [_markdown(mean_table(plan, shown))]
    for name, source in plan.sources.items():
        if name in set(shown["source"]):
            parts += [f"**{source.title}** ({source.scanner}, {source.licence})", _markdown(_of_source(shown, name))]
    return "\n\n".join([NOTE, *parts]) + "\n"


def _markdown(table: pd.DataFrame) -> str:
    def text(value: Any) -> str:
        if isinstance(value, float):
            return "" if pd.isna(value) else f"{value:.2f}"
        return str(value)

    head = f"| {' | '.join(map(str, table.columns))} |\n|{'---|' * len(table.columns)}"
    rows = (f"| {' | '.join(map(text, row))} |" for row in table.itertuples(index=False, name=None))
    return "\n".join([head, *rows])


def summary(plan: stages.StudyPlan, benchmark: pd.DataFrame) -> dict[str, Any]:
    """Return the recordings and all rows of the benchmark as JSON values."""
    rows = [
        {str(k): v for k, v in row.items() if not (isinstance(v, float) and pd.isna(v))}
        for row in benchmark.to_dict(orient="records")
    ]
    sources = {
        name: {"title": s.title, "scanner": s.scanner, "licence": s.licence, "classes": list(s.classes)}
        for name, s in plan.sources.items()
    }
    return {"scheme": plan.scheme.name, "sources": sources, "runs": rows}


REACH = 50.0
"""Drawn surroundings of the middle of a scene, metres; beyond, points of single scans lie too far apart to see."""


def source_pages(plan: stages.StudyPlan, scenes: SceneCollection, runs: SceneCollection) -> dict[str, str]:
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
        sections = [facts_section("Recording", {"scanner": source.scanner, "licence": source.licence, "scene": middle})]
        for key in keys:
            run = stages.Run.parse(key)
            label = runs.part("picture")[key].load()["label"]
            figures = scene_figures(plan, run, scene, label)
            sections.append(figures_section(f"{run.method}, {run.protocol}", figures))
        pages[name] = build_report(sections, title=source.title)
    return pages


def scene_figures(
    plan: stages.StudyPlan, run: stages.Run, scene: PointCloud, label: NDArray[np.integer]
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


def tabulate(plan: stages.StudyPlan, runs: SceneCollection, models: SceneCollection) -> dict[str, pd.DataFrame]:
    """Make the tables of all stored runs."""
    return study_tables(plan, runs.load_all(), models.load_all("times"))


def summarise(plan: stages.StudyPlan, benchmark: pd.DataFrame) -> tuple[dict[str, Any], str]:
    """Return the benchmark as JSON values and as text tables."""
    return summary(plan, benchmark), markdown_tables(plan, benchmark)


STUDY = studies.Study(
    "recordings",
    "Labellers on recordings",
    parameters=("classes", *stages.STAGES, *methods_of("labelling")),
    plan=stages.plan_study,
    stages=[
        studies.Stage("read_recordings", stages.read_scenes, [], "scenes"),
        studies.Stage("prepare_recordings", stages.prepare_scenes, ["scenes"], "prepared"),
        studies.Stage("train_on_recordings", stages.train_models, ["prepared"], "models"),
    ],
    results=["runs", "models"],
    tables=("scores", "benchmark", "reliability"),
    tabulate=tabulate,
    captions=CAPTIONS,
    draw=study_figures,
    facts=study_facts,
    page=study_page,
)
