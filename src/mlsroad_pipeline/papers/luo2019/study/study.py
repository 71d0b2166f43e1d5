"""Study of Luo et al. 2019: its plan, figures, and its page with the paper's results beside ours."""

from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mlsroad_pipeline.algorithms.core.classes import find_scheme
from mlsroad_pipeline.execution.task import SceneTask, SourceFile
from mlsroad_pipeline.papers.luo2019.study import plan as luo2019
from mlsroad_pipeline.papers.luo2019.study.results import LEVELS, study_tables
from mlsroad_pipeline.papers.luo2019.study.sets import SimulatedObjectsParameters
from mlsroad_pipeline.papers.shared.recognition.object_set import find_folds, listed_files, read_fold
from mlsroad_pipeline.papers.shared.studies import study as drawing
from mlsroad_pipeline.papers.shared.studies.parameters import method_parameters
from mlsroad_pipeline.papers.shared.studies.study import Shown, Stage, Study, Tables

_TITLES = {
    "noise": "Standard deviation of Gaussian noise", "keep": "Share of the points kept", "outliers": "Rate of outliers",
    "occlusion": "Rate of occlusion", luo2019.LABELS: "Share of wrong classes",
}  # fmt: skip
CAPTIONS = {
    "figure_7": "Figure 7: image sizes",
    "figure_9": "Figure 9: F1 of the sub-networks on the paper's disturbed test sets",
    "figure_10": "Figure 10: confusion matrices on these sets, share of each true class",
    "figure_11": "Figure 11: precision and recall",
    "figure_12": "Figure 12: disturbed test objects",
    "figure_13": "Figures 13 and 14c: disturbed training objects, tested on undisturbed ones",
    "figure_14": "Figures 14a and 14b: combined disturbances of training objects",
}
"""Name of each figure to its caption."""


def study_figures(tables: Tables) -> tuple[Figure, ...]:
    """Draw the figures in the order of `CAPTIONS`."""
    curves = tables["curves"]
    seven, eleven, fourteen = (curves[curves["figure"] == number] for number in (7, 11, 14))
    return (
        _figure_7(seven), _figure_9(tables["sub_networks"]), _figure_10(tables["confusion_counts"]), _figure_11(eleven),
        _figure_12(tables["robustness"]), _figure_13(tables["training"]), _figure_14(fourteen),
    )  # fmt: skip


def _curve_panel(axes: Axes, curves: pd.DataFrame, settings: Iterable[str], title: str, *, legend: bool) -> None:
    each = {setting: curves[curves["setting"] == setting] for setting in settings}
    drawing.draw_curves(axes, {name.replace("_", " "): (one["recall"], one["precision"]) for name, one in each.items()})
    drawing.name_axes(axes, x="Recall", y="Precision", title=title, unit_range="xy")
    drawn = axes.get_legend()
    if drawn is not None and not legend:
        drawn.remove()


def _figure_7(curves: pd.DataFrame) -> Figure:
    views = list(dict.fromkeys(setting.partition("=")[0] for setting in curves["setting"]))
    figure, panels = drawing.draw_panels(len(LEVELS), rows=max(len(views), 1))
    for k, view in enumerate(views):
        settings = [s for s in dict.fromkeys(curves["setting"]) if s.startswith(f"{view}=")]
        for axes, level in zip(panels[k * len(LEVELS) : (k + 1) * len(LEVELS)], LEVELS, strict=True):
            title = f"{view.upper()}, test set {level[-1]}"
            _curve_panel(axes, curves[curves["tested_on"] == level], settings, title, legend=True)
    return figure


def _figure_9(table: pd.DataFrame) -> Figure:
    classes, methods = list(dict.fromkeys(table["class"])), (*luo2019.SUB_NETWORKS, luo2019.JOINTNET)
    figure, panels = drawing.draw_panels(1, rows=len(LEVELS), width=10.0, height=2.6)
    for axes, level in zip(panels, LEVELS, strict=True):
        mine = table[table["level"] == level].pivot(index="class", columns="method", values="f1").reindex(classes)
        drawing.draw_bars(axes, classes, {method: mine[method] for method in methods})
        drawing.name_axes(axes, y=f"F1, test set {level[-1]}", unit_range="y")
    drawing.legend_below(figure, panels[0], len(methods))
    return figure


def _figure_10(table: pd.DataFrame) -> Figure:
    methods, classes = (*luo2019.SUB_NETWORKS, luo2019.JOINTNET), list(dict.fromkeys(table["class"]))
    figure, panels = drawing.draw_panels(len(methods), rows=len(LEVELS), width=2.9, height=2.9)
    for axes, (level, method) in zip(panels, product(LEVELS, methods), strict=True):
        mine = table[(table["level"] == level) & (table["method"] == method)]
        counts = mine.pivot_table(index="class", columns="recognised", values="objects", aggfunc="sum")
        shares = counts.reindex(index=classes, columns=classes).fillna(0).to_numpy(dtype=np.float64)
        axes.imshow(shares / np.maximum(shares.sum(axis=1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1)
        axes.set_xticks(range(len(classes)), classes, rotation=90, fontsize=6)
        axes.set_yticks(range(len(classes)), classes, fontsize=6)
        axes.grid(visible=False)
        drawing.name_axes(axes, title=f"{method.replace('_', ' ')}, test set {level[-1]}")
    return figure


def _figure_11(curves: pd.DataFrame) -> Figure:
    sets = list(dict.fromkeys(curves["set"]))
    figure, panels = drawing.draw_panels(len(sets), width=4.6, height=4.6)
    for axes, name in zip(panels, sets, strict=True):
        _curve_panel(axes, curves[curves["set"] == name], luo2019.METHODS, name, legend=False)
    drawing.legend_below(figure, panels[0], 3)
    return figure


def _levels(axes: Axes, series: dict[str, pd.DataFrame], kind: str, title: str) -> None:
    """Draw accuracy by level, starting with undisturbed objects; the axis of down-sampling is logarithmic."""
    start = 1.0 if kind == "keep" else 0.0
    lines = {}
    for name, table in series.items():
        mine = table[table["disturbance"].isin([luo2019.CLEAN, kind])]
        level = mine["level"].where(mine["disturbance"] != luo2019.CLEAN, start)
        lines[name] = pd.Series(mine["accuracy"].to_numpy(), index=level.to_numpy()).sort_index()
    if lines:
        at = next(iter(lines.values())).index.to_numpy()
        drawing.draw_lines(axes, at, lines, bold=[luo2019.JOINTNET])
    if kind == "keep":
        axes.set_xscale("log", base=2)
        axes.xaxis.set_inverted(True)
    drawing.name_axes(axes, x=_TITLES[kind], y="Accuracy", title=title, unit_range="y")


def _figure_12(table: pd.DataFrame) -> Figure:
    sets = list(dict.fromkeys(table["set"]))
    figure, panels = drawing.draw_panels(len(luo2019.KINDS), rows=len(sets))
    for axes, (name, kind) in zip(panels, product(sets, luo2019.KINDS), strict=True):
        mine = table[table["set"] == name]
        _levels(axes, {method: mine[mine["method"] == method] for method in luo2019.METHODS}, kind, name)
    drawing.legend_below(figure, panels[0], len(luo2019.METHODS))
    return figure


def _figure_13(table: pd.DataFrame) -> Figure:
    kinds = [kind for kind in (*luo2019.KINDS, luo2019.LABELS) if kind in set(table["disturbance"])]
    figure, panels = drawing.draw_panels(max(len(kinds), 1), width=3.6)
    for axes, kind in zip(panels, kinds, strict=False):
        _levels(axes, {name: table[table["set"] == name] for name in dict.fromkeys(table["set"])}, kind, "")
    drawing.legend_below(figure, panels[0], 4)
    return figure


def _figure_14(curves: pd.DataFrame) -> Figure:
    sets = list(dict.fromkeys(curves["set"]))
    settings = [s for s in dict.fromkeys(curves["setting"]) if s == luo2019.CLEAN or s.startswith(luo2019.COMBINED)]
    figure, panels = drawing.draw_panels(max(len(sets), 1), width=4.6)
    for axes, name in zip(panels, sets, strict=False):
        _curve_panel(axes, curves[curves["set"] == name], settings, name, legend=True)
    return figure


FOLDS, SYDNEY_SCHEME = "folds/fold*.txt", "sydney14"


def plan_study(
    study: luo2019.StudyParameters,
    simulated_objects: SimulatedObjectsParameters,
    classes: Mapping[str, Any],
    **methods: Any,
) -> luo2019.StudyPlan:
    """Plan the runs; sub-networks have the parameters of JointNet."""
    own = method_parameters(methods)
    own = {method: own.get(method, own[luo2019.JOINTNET]) for method in luo2019.METHODS}
    names = tuple(simulated_objects.chosen_sets())
    schemes = {name: find_scheme(classes["schemes"], name) for name in names}
    folds = {} if study.sydney is None else {n: str(p) for n, p in find_folds(study.sydney, FOLDS).items()}
    if folds:
        schemes[luo2019.SYDNEY] = find_scheme(classes["schemes"], SYDNEY_SCHEME)
    return luo2019.StudyPlan(study, names, schemes, folds, own)


def read_folds(plan: luo2019.StudyPlan) -> dict[str, SceneTask]:
    """Create one task per fold of the Sydney Urban Objects that reads it."""
    return {
        f"{luo2019.SYDNEY}.{name}": SceneTask(
            read_fold,
            {"path": SourceFile(path), "files": [SourceFile(str(file)) for file in listed_files(Path(path))]},
            {"scheme": plan.schemes[luo2019.SYDNEY]},
        )
        for name, path in plan.folds.items()
    }


def study_facts(plan: luo2019.StudyPlan) -> dict[str, Any]:
    """Return the settings of the runs."""
    scale = plan.scale
    return {
        "scale": plan.study.scale,
        "seeds of the methods": ", ".join(map(str, scale.seeds)),
        **{
            f"{luo2019.COMBINED}={i}": f"noise, share kept, outliers, occlusion {list(v)}"
            for i, v in enumerate(scale.combined, 1)
        },
        "Figures 7, 13 and 14": f"jointnet with {dict(scale.variants)}" if scale.variants else "jointnet unchanged",
        "Sydney Urban Objects": ", ".join(plan.folds) or "not used",
    }


_TIMES = (
    "CPU time on one thread, batches of 32 objects of 1,000 points. Memory of a training step: weights, gradients, "
    "momenta and tensors stored for the backward pass. The paper's values are of a GPU; its recognition times are "
    "of test sets of about 4,500 and 1,900 objects."
)
PAGE = {
    "table_2": ("Table 2: methods", "Means over classes on undisturbed test objects."),
    "table_3": ("Table 3: Sydney Urban Objects", ""),
    "differences": (
        "Differences from JointNet",
        "Mean F1 of a method minus that of jointnet; 95 % bootstrap intervals of 2,000 samples of test streets.",
    ),
    "table_1": ("Table 1: sub-networks", _TIMES),
    "table_4": ("Table 4: efficiency", _TIMES),
    "image_sizes": ("Figure 7: image sizes", ""),
    "size_grid": ("Combinations of image sizes", ""),
    "robustness": ("Figure 12: disturbed test objects", ""),
    "training": ("Figures 13 and 14: disturbed training objects", ""),
    "tuning": ("Settings tried on validation objects", ""),
}
"""Name of each table of the page to its title and note."""


def study_page(plan: luo2019.StudyPlan, tables: Tables) -> list[Shown]:
    """Return the tables of the page."""
    return [Shown(title, tables[name], note) for name, (title, note) in PAGE.items()]


STUDY = Study(
    "luo2019",
    "Luo et al. 2019 on simulated objects",
    parameters=("simulated_objects", "classes", luo2019.JOINTNET, luo2019.TUNED, luo2019.PRINTED, *luo2019.BASELINES),
    plan=plan_study,
    stages=[
        Stage("read_luo2019_folds", read_folds, [], "folds"),
        Stage("measure_luo2019_networks", luo2019.measure_networks, [], "networks"),
        Stage("run_luo2019_methods", luo2019.run_methods, ["simulated_objects.sets", "folds"], "runs"),
    ],
    results=["runs", "networks"],
    tables=("scores", "sub_networks", "confusion_counts", "curves", *PAGE),
    tabulate=study_tables,
    captions=CAPTIONS,
    draw=study_figures,
    facts=study_facts,
    page=study_page,
)
