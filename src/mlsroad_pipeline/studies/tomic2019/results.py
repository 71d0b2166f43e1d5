"""From the results of all runs of the study of Tomic et al. 2019 to its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.image_labels.cityscapes import CITYSCAPES, SKY, image_classes, segmentation_table
from mlsroad_pipeline.algorithms.metrics.confusion import scores as figures_of
from mlsroad_pipeline.algorithms.metrics.scores import CLASS_METRICS, labelling_scores
from mlsroad_pipeline.studies.tables import Tables, mean_and_spread
from mlsroad_pipeline.studies.tomic2019 import paper
from mlsroad_pipeline.studies.tomic2019.plan import OWN, PRINTED, StudyPlan
from mlsroad_pipeline.studies.tomic2019.scores import (
    ALL_POINTS,
    ANSWERS,
    BY_F1,
    FEATURES,
    IMAGES,
    POOL,
    RULE,
    VISIBLE,
)

Results = Mapping[str, Mapping[str, Any]]
"""Key of a task to what it gave."""

OVERALL = ("overall_accuracy", "kappa", "mean_f1")


@dataclass(frozen=True)
class StudyTables(Tables):
    """The tables of the study; figures are means over the surveys, with their standard deviation as ``_spread``.

    Parameters
    ----------
    scores : DataFrame
        The table of scores; its splits are the surveys' test sets 2, whole and visible.
    table_1 : DataFrame
        IoU of the images per class and category.
    table_2 : DataFrame
        F1 of both methods on test set 1, and how many surveys prefer the images for a class.
    table_3, table_4, table_5 : DataFrame
        Precision, recall, IoU and F1 per class on test set 2: of method 1, of the images, of the fusions.
    overall : DataFrame
        Overall accuracy, kappa and mean F1 of all methods, on all points and on the visible ones.
    gains : DataFrame
        Survey by survey: errors of the fusions by those of the better method, and what mean F1 gains over the better.
    cameras : DataFrame
        F1 of each camera on test set 1.
    redundancy : DataFrame
        Points of test set 2 by the number of labellers and of those that agree with the fusion.
    forests : DataFrame
        What is told of the trained forests and pools.
    """

    scores: pd.DataFrame
    table_1: pd.DataFrame
    table_2: pd.DataFrame
    table_3: pd.DataFrame
    table_4: pd.DataFrame
    table_5: pd.DataFrame
    overall: pd.DataFrame
    gains: pd.DataFrame
    cameras: pd.DataFrame
    redundancy: pd.DataFrame
    forests: pd.DataFrame


def answer_name(answer: str, forest: str) -> str:
    """Return what a labelling is called in the tables."""
    return {FEATURES: forest, IMAGES: "image_labels"}.get(answer, f"{answer}.{forest}")


def _answers(plan: StudyPlan) -> list[tuple[str, str]]:
    """Return method 1 and answer of every row of the tables in their order."""
    first = [(PRINTED, FEATURES), (OWN, FEATURES), (PRINTED, IMAGES)]
    return first + [(forest, answer) for forest in plan.forests for answer in (RULE, POOL, BY_F1)]


def study_tables(plan: StudyPlan, runs: Results, pixels: Results, forests: Results) -> StudyTables:
    """Make the tables."""
    each = pd.concat(
        [
            labelling_scores(
                runs[f"{forest}.{street}"][f"{answer}.{split}"],
                method=answer_name(answer, forest), split=f"{street}.{split}", classes=plan.scheme.classes,
            ).assign(street=street, part=split)
            for split in (ALL_POINTS, VISIBLE)
            for forest, answer in _answers(plan)
            for street in plan.streets
        ],
        ignore_index=True,
    )  # fmt: skip
    whole = each[each["part"] == ALL_POINTS]
    fused = [answer_name(answer, forest) for forest in plan.forests for answer in (RULE, POOL)]
    return StudyTables(
        scores=each.drop(columns=["street", "part"]),
        table_1=_segmentation(plan, pixels),
        table_2=_method_f1(plan, runs),
        table_3=_by_class(whole, list(plan.forests), paper.FEATURES),
        table_4=_by_class(whole, [answer_name(IMAGES, "")], paper.IMAGES),
        table_5=_by_class(whole, fused, paper.FUSION),
        overall=_overall(each),
        gains=_gains(plan, runs),
        cameras=_camera_f1(plan, runs),
        redundancy=_redundancy(plan, runs),
        forests=_forests(plan, runs, forests),
    )


def _spread(table: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Return mean and spread over surveys, each column beside its spread."""
    found = mean_and_spread(table, by, columns)
    return found[[*by, *(name for column in columns for name in (column, f"{column}_spread"))]]


def _segmentation(plan: StudyPlan, pixels: Results) -> pd.DataFrame:
    classes = image_classes(plan.scheme)
    category = {becomes or SKY: kind for kind, becomes in reversed(CITYSCAPES.values())}
    kinds = [category[name] for name in classes]
    tables = [segmentation_table(pixels[street]["matrix"], classes, kinds) for street in plan.streets]
    found = _spread(pd.concat(tables), ["kind", "name"], ["iou"])
    return found.merge(paper.table_one(), on=["kind", "name"], how="left")


def _method_f1(plan: StudyPlan, runs: Results) -> pd.DataFrame:
    rows = []
    for forest in plan.forests:
        for street in plan.streets:
            first, second = runs[f"{forest}.{street}"]["method_f1"]
            rows += [
                (forest, name, float(a), float(b), float(b > a))
                for name, a, b in zip(plan.scheme.classes, first, second, strict=True)
            ]
    table = pd.DataFrame(rows, columns=["features", "class", "features_f1", "images_f1", "prefer_images"])
    groups = ["features", "class"]
    chosen = table.groupby(groups, sort=False)["prefer_images"].sum().astype(int).reset_index()
    found = _spread(table, groups, ["features_f1", "images_f1"]).merge(chosen, on=groups)
    return found.merge(paper.table_two(), on="class", how="left")


def _by_class(scores: pd.DataFrame, methods: Sequence[str], printed: str) -> pd.DataFrame:
    """Return a row per method and class, the paper's figures beside ours."""
    rows = scores[scores["method"].isin(methods) & (scores["class"] != "all")]
    wide = rows.pivot(index=["method", "class", "street"], columns="metric", values="value").reset_index()
    order = {name: k for k, name in enumerate(methods)}
    places = {name: k for k, name in enumerate(dict.fromkeys(rows["class"]))}
    wide = wide.sort_values(["method", "class"], key=lambda c: c.map(order | places), kind="stable")
    told = paper.table_of_scores(printed)
    told = told[told["class"] != "all"].pivot(index="class", columns="metric", values="paper")[list(CLASS_METRICS)]
    told = told.rename(columns="paper_{}".format).reset_index()
    return _spread(wide, ["method", "class"], CLASS_METRICS).merge(told, on="class", how="left")


def _overall(each: pd.DataFrame) -> pd.DataFrame:
    rows = each[(each["class"] == "all") & each["metric"].isin(OVERALL)]
    order = list(dict.fromkeys(zip(rows["part"], rows["method"], strict=True)))
    wide = rows.pivot(index=["part", "method", "street"], columns="metric", values="value").reset_index()
    found = _spread(wide, ["part", "method"], OVERALL).set_index(["part", "method"]).loc[order].reset_index()
    printed = {PRINTED: paper.FEATURES, answer_name(IMAGES, ""): paper.IMAGES, answer_name(RULE, PRINTED): paper.FUSION}
    for metric in OVERALL:
        values = {
            method: float(told.loc[(told["class"] == "all") & (told["metric"] == metric), "paper"].iloc[0])
            for method, told in ((method, paper.table_of_scores(name)) for method, name in printed.items())
        }
        found[f"paper_{metric}"] = found["method"].map(values).where(found["part"] == ALL_POINTS)
    return found


def _gains(plan: StudyPlan, runs: Results) -> pd.DataFrame:
    rows = []
    for forest in plan.forests:
        for street in plan.streets:
            run = runs[f"{forest}.{street}"]
            found = {name: figures_of(run[f"{name}.{ALL_POINTS}"]) for name in ANSWERS}
            alone = [found[FEATURES], found[IMAGES]]
            accuracy, f1 = max(one.overall_accuracy for one in alone), max(one.mean_f1 for one in alone)
            rows += [
                (
                    forest, street, name, found[name].overall_accuracy, accuracy,
                    (1 - found[name].overall_accuracy) / max(1 - accuracy, 1e-12),
                    found[name].mean_f1, f1, found[name].mean_f1 - f1,
                )
                for name in (RULE, POOL, BY_F1)
            ]  # fmt: skip
    columns = [
        "features", "street", "fusion", "overall_accuracy", "better_method", "error_ratio", "mean_f1", "better_mean_f1",
        "f1_gain",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def _camera_f1(plan: StudyPlan, runs: Results) -> pd.DataFrame:
    rows = [
        (str(camera), name, float(value))
        for street in plan.streets
        for run in [runs[f"{PRINTED}.{street}"]]
        for camera, values in zip(run["cameras"], run["camera_f1"], strict=True)
        for name, value in zip(plan.scheme.classes, values, strict=True)
    ]
    return _spread(pd.DataFrame(rows, columns=["camera", "class", "f1"]), ["camera", "class"], ["f1"])


def _redundancy(plan: StudyPlan, runs: Results) -> pd.DataFrame:
    rows = []
    for forest in plan.forests:
        total = np.sum([runs[f"{forest}.{street}"]["redundancy"] for street in plan.streets], axis=0)
        rows += [
            (forest, given, agree, int(total[given, agree]), float(total[given, agree] / total.sum()))
            for given in range(len(total))
            for agree in range(given + 1)
            if total[given].sum()
        ]
    return pd.DataFrame(rows, columns=["features", "labellers", "agree", "points", "share"])


def _forests(plan: StudyPlan, runs: Results, forests: Results) -> pd.DataFrame:
    rows = [
        {
            "forest": forest, "street": street, **{key: float(value) for key, value in facts.items()},
            "pool_penalty": float(runs[f"{forest}.{street}"]["penalty"]),
        }
        for forest in plan.forests
        for street in plan.streets
        for facts in [forests[f"{forest}.{street}"]]
    ]  # fmt: skip
    return pd.DataFrame(rows)
