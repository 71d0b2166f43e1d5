"""Study of Luo et al. 2016: tables from the results of its runs, and its page with the paper's results beside ours."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.scores import ALL, check_scores
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.execution.task import SceneTask
from mlsroad_pipeline.papers.luo2016.study import plan as stages
from mlsroad_pipeline.papers.luo2016.study.figures import CAPTIONS, study_figures
from mlsroad_pipeline.papers.luo2016.study.runs import CONFIGURED, METHODS, PRINTED_REFINED, REFINED, RunResult
from mlsroad_pipeline.papers.luo2016.study.scores import (
    CLASSES,
    MEANS,
    OBJECTS,
    all_pairs,
    paired_differences,
    repetition_scores,
    sensitivity_table,
    table_three,
    times_table,
)
from mlsroad_pipeline.papers.shared.studies.streets import make_street, street_tasks
from mlsroad_pipeline.papers.shared.studies.study import Shown, Stage, Study, Tables, paper_table

Results = Mapping[str, RunResult]
"""Key of a run to its result."""

PREDICTED = {"shape_based": OBJECTS, "shape_based_printed": OBJECTS}
"""Classes of a method that predicts only some: shape-based recognition does not label the ground."""


def study_tables(
    plan: stages.StudyPlan, patches: SceneCollection, trials: SceneCollection, runs: SceneCollection
) -> dict[str, pd.DataFrame]:
    """Make the tables; splits of the scores are the test streets, steps of `by_size` and `by_radius` millimetres."""
    counts = patches.part("counts")
    streets = [counts[key].load() for key in plan.counted_keys()]
    tried, results = trials.load_all(), runs.load_all()
    parameters = plan.tuned(tried)
    classes = plan.scheme.classes
    matrices: dict[str, dict[str, NDArray[np.int64]]] = {}
    facts = []
    for run in plan.comparison_runs(parameters):
        result = results[run.key]
        for place, seed in enumerate(run.test):
            here = {method: counts[place] for method, counts in result["matrices"].items()}
            matrices.setdefault(f"test_{seed}", {}).update(here)
        per_street = result["facts"]["label_seconds"] / len(run.test)
        facts.append(result["facts"].assign(label_seconds=per_street))
    ordered = {street: {m: each[m] for m in METHODS} for street, each in matrices.items()}
    scores = repetition_scores(ordered, classes=classes, given=PREDICTED)
    times = times_table(pd.concat(facts, ignore_index=True)).set_index("method").reindex(list(METHODS)).reset_index()
    hours = paper_table("luo2016", "hours")
    size = _sensitivity(plan.size_runs(parameters), results, classes, REFINED)
    radius = _sensitivity(plan.radius_runs(parameters), results, classes, PRINTED_REFINED)
    return {
        "scores": scores_frame(scores, ordered, classes),
        "table_3": table_three(scores),
        "differences": paired_differences(scores),
        "pairs": all_pairs(scores),
        "table_1": table_one(streets, classes),
        "patch_size": size,
        "search_radius": radius,
        "times": times.merge(hours, on="method", how="left"),
        "tuning": _tuning(plan, tried),
        "by_size": by_step(size, "patch_size"),
        "by_radius": by_step(radius, "search_radius"),
    }


def _sensitivity(
    runs: Mapping[float, Sequence[stages.StudyRun]], results: Results, classes: Sequence[str], method: str
) -> pd.DataFrame:
    """Score a method at every value, over the test streets of all runs of the value."""
    matrices: dict[float, dict[str, dict[str, NDArray[np.int64]]]] = {}
    facts: dict[float, pd.DataFrame] = {}
    for value, repetitions in runs.items():
        if not repetitions:
            continue
        found = [(run, results[run.key]) for run in repetitions]
        matrices[value] = {
            f"test_{seed}": {method: result["matrices"][method][place]}
            for run, result in found
            for place, seed in enumerate(run.test)
        }
        facts[value] = pd.concat([r["facts"][r["facts"]["method"] == method] for _, r in found])
    return sensitivity_table(matrices, facts, classes=classes)


def table_one(streets: Sequence[Mapping[str, NDArray[np.int64]]], classes: Sequence[str]) -> pd.DataFrame:
    """Return the points and objects of all streets by class beside Table I of the paper."""
    kinds = ("points", "objects", "touching")
    totals = {kind: np.sum([street[kind] for street in streets], axis=0) for kind in kinds}
    table = pd.DataFrame({"class": list(classes), **totals})
    table["share"] = table["points"] / table["points"].sum()
    paper = paper_table("luo2016", "table_1")
    paper["paper_share"] = paper["paper_points"] / paper["paper_points"].sum()
    return table.merge(paper, on="class", how="left")


def scores_frame(
    scores: pd.DataFrame, matrices: Mapping[str, Mapping[str, NDArray[np.int64]]], classes: Sequence[str]
) -> pd.DataFrame:
    """Convert scores of `repetition_scores` to the common table of scores."""
    support = {
        (repetition, method): dict(zip(classes, matrix.sum(axis=1).tolist(), strict=True))
        for repetition, methods in matrices.items()
        for method, matrix in methods.items()
    }
    rows = []
    for repetition, method, name, metric, value in scores.itertuples(index=False, name=None):
        counts = support[repetition, method]
        if name in CLASSES:
            rows.append((method, repetition, name, metric, value, counts[name]))
        elif (name, metric) == ("mean of seven", "f1"):
            rows.append((method, repetition, ALL, "mean_f1", value, sum(counts[c] for c in CLASSES)))
    columns = ["method", "split", "class", "metric", "value", "support"]
    return check_scores(pd.DataFrame(rows, columns=columns))


def by_step(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Convert a table of `sensitivity_table` to metrics by step in millimetres."""
    steps = (1000 * table["value"]).round().astype(np.int64)
    kept = table[[*MEANS, "train_seconds", "objective"]].astype(np.float64).dropna(axis="columns")
    kept.columns = [f"{name}_{str(column).replace(' ', '_')}" for column in kept.columns]
    return pd.concat([steps.rename("millimetres"), kept], axis=1)


def _tuning(plan: stages.StudyPlan, tried: Results) -> pd.DataFrame:
    chosen = plan.tuned(tried)
    settings = [setting for tried_of in plan.scale.tuning.values() for setting in tried_of]
    rows = [
        {
            "method": run.method,
            "setting": ", ".join(f"{key} {value}" for key, value in setting.items()),
            "mean_f1": plan.tuning_score(run, tried[run.key]["matrices"]),
            "chosen": run.parameters[run.method] == chosen[run.method],
        }
        for run, setting in zip(plan.tuning_runs(), settings, strict=True)
    ]
    return pd.DataFrame(rows, columns=["method", "setting", "mean_f1", "chosen"])


PAPER_ON_PATCH_SIZE = (
    "Paper (diamonds at 0.2 m: its Table III; its curves are not given as numbers): F1 of road, grass, palm tree and "
    "cycas changes slightly. F1 of vehicle falls from 0.85 at 0.20 m to 0.69 at 0.35 m, that of light pole sharply "
    "from 0.30 to 0.35 m. Training time falls with patch size. The paper uses 0.2 m."
)
PAPER_ON_SEARCH_RADIUS = (
    "Paper (diamonds at 1.0 m: its Table III): F1 hardly changes from 0.3 to 1.5 m. The objective (Figure 11) falls "
    "and training time (Figure 10) rises with the radius. The paper uses 1.0 m."
)

NOTE_ON_TABLE_1 = (
    "Objects with at least 100 points. Touching: a patch of the object is beside a patch of another object; the paper "
    "counts overlapping objects by eye."
)
NOTE_ON_PAIRS = (
    "Mean F1 of the first method minus that of the second, paired by test street, with 95 % intervals; sure: the "
    "interval does not contain 0. The intervals hold for one pair at a time, p of the paired t-test for all pairs "
    "together (Holm 1979)."
)


def wide_table(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return Table III as text: one row per method, "mean (paper)" per class, "± spread" for means over classes."""
    chosen = table[table["metric"] == metric]
    spread = chosen["spread"].where(chosen["class"].isin(MEANS))  # ten columns with spreads do not fit on a page
    rows = zip(chosen["mean"], spread, chosen["paper"], strict=True)
    cells = [_cell(*row) for row in rows]
    wide = chosen.assign(cell=cells).pivot(index="method", columns="class", values="cell")
    order = list(dict.fromkeys(chosen["method"]))
    return wide.reindex(index=order, columns=[*CLASSES, *MEANS]).rename_axis(columns=None).reset_index()


def _cell(mean: float, spread: float, paper: float) -> str:
    ours = "–" if np.isnan(mean) else f"{mean:.3f}" if np.isnan(spread) else f"{mean:.3f} ± {spread:.3f}"
    return f"{ours} ({'–' if np.isnan(paper) else f'{paper:.3f}'})"


def _listed(values: Mapping[str, Any]) -> str:
    """Return names and values as one line, nested ones in brackets."""
    pairs = ((key, f"({_listed(v)})" if isinstance(v, Mapping) else v) for key, v in values.items())
    return ", ".join(f"{key} {value}" for key, value in pairs)


def study_facts(plan: stages.StudyPlan) -> dict[str, Any]:
    """Return the streets of the runs."""
    scale = plan.scale
    return {
        "scale": plan.study.scale,
        "streets": _listed(scale.survey),
        "test streets": _listed(scale.test_survey) or "same as training streets",
        **{f"test streets {list(r['test'])}": f"trained on {list(r['train'])}" for r in scale.repetitions},
    }


def study_page(plan: stages.StudyPlan, tables: Tables) -> list[Shown]:
    """Return the tables of the page."""
    note = "Ours ± standard deviation over test streets (paper in brackets). "
    note += "The paper swaps the names of precision and recall; here both have their usual meaning."
    apart = "Mean F1 of a method minus that of patch_graph_mrf, with 95 % intervals of the paired differences."
    return [
        Shown("Table I: points and objects of all streets", tables["table_1"].round(4), NOTE_ON_TABLE_1),
        *(
            Shown(f"Table III: {name}", wide_table(tables["table_3"], metric), note)
            for name, metric in (("F1", "f1"), ("precision", "precision"), ("recall", "recall"))
        ),
        Shown("Differences from label transfer with refinement", tables["differences"].round(3), apart),
        Shown("Differences of every two methods", tables["pairs"].round(3), NOTE_ON_PAIRS),
        Shown("Patch size", tables["patch_size"].round(3), PAPER_ON_PATCH_SIZE),
        Shown("Local search radius", tables["search_radius"].round(3), PAPER_ON_SEARCH_RADIUS),
        Shown("Times", tables["times"], "CPU seconds here; hours on the paper's computer."),
        Shown("Settings tried on training streets", tables["tuning"]),
    ]


def make_streets(plan: stages.StudyPlan) -> dict[str, SceneTask]:
    """Create one task per street that simulates it."""
    columns = ("rgb", "label", "instance")
    return street_tasks(make_street, plan.surveys(), ground=plan.ground, columns=columns, with_station=True)


STUDY = Study(
    "luo2016",
    "Luo et al. 2016 on simulated streets",
    parameters=("classes", "ground_removal", "patches", *CONFIGURED),
    plan=stages.plan_study,
    stages=[
        Stage("make_luo2016_streets", make_streets, [], "streets"),
        Stage("cut_luo2016_streets", stages.cut_streets, ["streets"], "patches"),
        Stage("try_luo2016_settings", stages.try_settings, ["streets", "patches"], "tried"),
        Stage("run_luo2016_methods", stages.run_methods, ["streets", "patches", "tried"], "runs"),
    ],
    results=["patches", "tried", "runs"],
    tables=(
        "scores", "table_3", "differences", "pairs", "table_1", "patch_size", "search_radius", "times", "tuning",
        "by_size", "by_radius",
    ),
    tabulate=study_tables,
    captions=CAPTIONS,
    draw=study_figures,
    facts=study_facts,
    page=study_page,
    shown=["plan", "streets", "runs"],
)  # fmt: skip
