"""Tables of the study of Tomic et al. 2019, made from the results of its tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.cityscapes import CITYSCAPES, SKY, image_classes, segmentation_table
from mlsroad_pipeline.algorithms.metrics.confusion import scores as figures_of
from mlsroad_pipeline.algorithms.metrics.scores import CLASS_METRICS, labelling_scores
from mlsroad_pipeline.papers.shared.studies.tables import Tables, mean_and_spread
from mlsroad_pipeline.papers.tomic2019.study import paper
from mlsroad_pipeline.papers.tomic2019.study.plan import HIDDEN, MAIN, OWN, PRINTED, StudyPlan
from mlsroad_pipeline.papers.tomic2019.study.scores import (
    ALL_POINTS,
    BY_F1,
    FEATURES,
    FIRST_VISIBLE,
    IMAGES,
    LABELLINGS,
    POOL,
    RULE,
    VISIBLE,
    FusionScores,
)


class FusionRun(NamedTuple):
    """Scores of one fusion, and the cameras in the order of their F1."""

    scores: FusionScores
    cameras: NDArray[np.str_]

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> FusionRun:
        """Return a run from stored arrays."""
        return cls(FusionScores.from_arrays(arrays), arrays["cameras"])


Runs = Mapping[str, FusionRun]
"""``<forest>.<street>`` to the scores of the fusion."""

OVERALL = ("overall_accuracy", "kappa", "mean_f1")


@dataclass(frozen=True)
class StudyTables(Tables):
    """Tables of the study: means over the surveys, with the standard deviation as ``_spread``."""

    scores: pd.DataFrame  # table of scores; its splits are test set 2 of each survey, all points and visible points
    table_1: pd.DataFrame  # IoU of the images per class and category
    # F1 of both methods on test set 1, and the number of surveys that prefer the images for a class
    table_2: pd.DataFrame
    # table_3, table_4, table_5: precision, recall, IoU and F1 per class on test set 2: of method 1, of the images, of
    # the fusions
    table_3: pd.DataFrame
    table_4: pd.DataFrame
    table_5: pd.DataFrame
    overall: pd.DataFrame  # overall accuracy, kappa and mean F1 of all methods, on all points and on the visible ones
    # by survey: error of each fusion relative to the better single method, and gain in mean F1 over it
    gains: pd.DataFrame
    cameras: pd.DataFrame  # F1 of each camera on test set 1
    # points of test set 2 by number of labellers and number of labellers that agree with the fusion
    redundancy: pd.DataFrame
    forests: pd.DataFrame  # size, out-of-bag score and CPU time of the trained forests, and penalty of the pools
    # variants of both methods, the rule and the pool: test set 2, and the visible points of test set 1
    variants: pd.DataFrame


def method_name(labelling: str, forest: str) -> str:
    """Return the name of a labelling in the tables."""
    return {FEATURES: forest, IMAGES: "image_labels"}.get(labelling, f"{labelling}.{forest}")


def _labellings() -> list[tuple[str, str]]:
    """Return forest and labelling of every row of the tables, in their order."""
    first = [(PRINTED, FEATURES), (OWN, FEATURES), (PRINTED, IMAGES)]
    return first + [(forest, labelling) for forest in MAIN for labelling in (RULE, POOL, BY_F1)]


def study_tables(
    plan: StudyPlan, runs: Runs, pixels: Mapping[str, NDArray[np.int64]], forests: Mapping[str, Mapping[str, NDArray]]
) -> StudyTables:
    """Make the tables from fusions, confusion matrices of the images by survey, and facts of the forests."""
    each = pd.concat(
        [
            labelling_scores(
                runs[f"{forest}.{street}"].scores.confusions[f"{labelling}.{split}"],
                method=method_name(labelling, forest), split=f"{street}.{split}", classes=plan.scheme.classes,
            ).assign(street=street, part=split)
            for split in (ALL_POINTS, VISIBLE)
            for forest, labelling in _labellings()
            for street in plan.streets
        ],
        ignore_index=True,
    )  # fmt: skip
    whole = each[each["part"] == ALL_POINTS]
    fused = [method_name(labelling, forest) for forest in MAIN for labelling in (RULE, POOL)]
    return StudyTables(
        scores=each.drop(columns=["street", "part"]),
        table_1=_segmentation(plan, pixels),
        table_2=_method_f1(plan, runs),
        table_3=_by_class(whole, list(MAIN), paper.FEATURES),
        table_4=_by_class(whole, [method_name(IMAGES, "")], paper.IMAGES),
        table_5=_by_class(whole, fused, paper.FUSION),
        overall=_overall(each),
        gains=_gains(plan, runs),
        cameras=_camera_f1(plan, runs),
        redundancy=_redundancy(plan, runs),
        forests=_forests(plan, runs, forests),
        variants=_variants(plan, runs),
    )


def _spread(table: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Return mean and spread over surveys, each column next to its spread."""
    means = mean_and_spread(table, by, columns)
    return means[[*by, *(name for column in columns for name in (column, f"{column}_spread"))]]


def _segmentation(plan: StudyPlan, pixels: Mapping[str, NDArray[np.int64]]) -> pd.DataFrame:
    classes = image_classes(plan.scheme)
    category = {becomes or SKY: kind for kind, becomes in reversed(CITYSCAPES.values())}
    kinds = [category[name] for name in classes]
    tables = [segmentation_table(pixels[street], classes, kinds) for street in plan.streets]
    table = _spread(pd.concat(tables), ["kind", "name"], ["iou"])
    return table.merge(paper.table_one(), on=["kind", "name"], how="left")


def _method_f1(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = []
    for forest in MAIN:
        for street in plan.streets:
            first, second = runs[f"{forest}.{street}"].scores.method_f1
            rows += [
                (forest, name, float(a), float(b), float(b > a))
                for name, a, b in zip(plan.scheme.classes, first, second, strict=True)
            ]
    table = pd.DataFrame(rows, columns=["features", "class", "features_f1", "images_f1", "prefer_images"])
    groups = ["features", "class"]
    chosen = table.groupby(groups, sort=False)["prefer_images"].sum().astype(int).reset_index()
    means = _spread(table, groups, ["features_f1", "images_f1"]).merge(chosen, on=groups)
    return means.merge(paper.table_two(), on="class", how="left")


def _by_class(scores: pd.DataFrame, methods: Sequence[str], printed: str) -> pd.DataFrame:
    """Return one row per method and class, with the paper's values next to ours."""
    rows = scores[scores["method"].isin(methods) & (scores["class"] != "all")]
    wide = rows.pivot(index=["method", "class", "street"], columns="metric", values="value").reset_index()
    order = {name: k for k, name in enumerate(methods)}
    places = {name: k for k, name in enumerate(dict.fromkeys(rows["class"]))}
    wide = wide.sort_values(["method", "class"], key=lambda c: c.map(order | places), kind="stable")
    table = paper.table_of_scores(printed)
    table = table[table["class"] != "all"].pivot(index="class", columns="metric", values="paper")[list(CLASS_METRICS)]
    table = table.rename(columns="paper_{}".format).reset_index()
    return _spread(wide, ["method", "class"], CLASS_METRICS).merge(table, on="class", how="left")


def _overall(each: pd.DataFrame) -> pd.DataFrame:
    rows = each[(each["class"] == "all") & each["metric"].isin(OVERALL)]
    order = list(dict.fromkeys(zip(rows["part"], rows["method"], strict=True)))
    wide = rows.pivot(index=["part", "method", "street"], columns="metric", values="value").reset_index()
    table = _spread(wide, ["part", "method"], OVERALL).set_index(["part", "method"]).loc[order].reset_index()
    printed = {PRINTED: paper.FEATURES, method_name(IMAGES, ""): paper.IMAGES, method_name(RULE, PRINTED): paper.FUSION}
    for metric in OVERALL:
        values = {
            method: float(rows.loc[(rows["class"] == "all") & (rows["metric"] == metric), "paper"].iloc[0])
            for method, rows in ((method, paper.table_of_scores(name)) for method, name in printed.items())
        }
        table[f"paper_{metric}"] = table["method"].map(values).where(table["part"] == ALL_POINTS)
    return table


def _gains(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = []
    for forest in MAIN:
        for street in plan.streets:
            confusions = runs[f"{forest}.{street}"].scores.confusions
            scored = {name: figures_of(confusions[f"{name}.{ALL_POINTS}"]) for name in LABELLINGS}
            alone = [scored[FEATURES], scored[IMAGES]]
            accuracy, f1 = max(one.overall_accuracy for one in alone), max(one.mean_f1 for one in alone)
            rows += [
                (
                    forest, street, name, scored[name].overall_accuracy, accuracy,
                    (1 - scored[name].overall_accuracy) / max(1 - accuracy, 1e-12),
                    scored[name].mean_f1, f1, scored[name].mean_f1 - f1,
                )
                for name in (RULE, POOL, BY_F1)
            ]  # fmt: skip
    columns = [
        "features", "street", "fusion", "overall_accuracy", "better_method", "error_ratio", "mean_f1", "better_mean_f1",
        "f1_gain",
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def _camera_f1(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = [
        (str(camera), name, float(value))
        for street in plan.streets
        for run in [runs[f"{PRINTED}.{street}"]]
        for camera, values in zip(run.cameras, run.scores.camera_f1, strict=True)
        for name, value in zip(plan.scheme.classes, values, strict=True)
    ]
    return _spread(pd.DataFrame(rows, columns=["camera", "class", "f1"]), ["camera", "class"], ["f1"])


def _redundancy(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = []
    for forest in MAIN:
        total = np.sum([runs[f"{forest}.{street}"].scores.redundancy for street in plan.streets], axis=0)
        rows += [
            (forest, labellers, agree, int(total[labellers, agree]), float(total[labellers, agree] / total.sum()))
            for labellers in range(len(total))
            for agree in range(labellers + 1)
            if total[labellers].sum()
        ]
    return pd.DataFrame(rows, columns=["features", "labellers", "agree", "points", "share"])


def _forests(plan: StudyPlan, runs: Runs, forests: Mapping[str, Mapping[str, NDArray]]) -> pd.DataFrame:
    rows = [
        {
            "forest": forest, "street": street, **{key: float(value) for key, value in facts.items()},
            "pool_penalty": runs[f"{forest}.{street}"].scores.penalty,
        }
        for forest in plan.forests
        for street in plan.streets
        for facts in [forests[f"{forest}.{street}"]]
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _variants(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    """Return the scores of every method 1, of both methods of visibility, and of their fusions."""
    rows = []
    for name in (*plan.forests, HIDDEN):
        for labelling in LABELLINGS:
            if (labelling == IMAGES and name not in (PRINTED, HIDDEN)) or (labelling == FEATURES and name == HIDDEN):
                continue
            for street in plan.streets:
                confusions = runs[f"{name}.{street}"].scores.confusions
                whole, seen = (confusions[f"{labelling}.{split}"] for split in (ALL_POINTS, VISIBLE))
                first = confusions.get(f"{labelling}.{FIRST_VISIBLE}")
                figures = figures_of(whole)
                variant = "depth_buffer" if labelling == IMAGES and name == PRINTED else name
                rows.append(
                    {
                        "labelling": labelling, "variant": variant, "overall_accuracy": figures.overall_accuracy,
                        "kappa": figures.kappa, "mean_f1": figures.mean_f1, "seen": seen.sum() / whole.sum(),
                        "visible_accuracy": figures_of(seen).overall_accuracy,
                        "test1_visible_accuracy": np.nan if first is None else figures_of(first).overall_accuracy,
                    }
                )  # fmt: skip
    columns = [*OVERALL, "seen", "visible_accuracy", "test1_visible_accuracy"]
    table = _spread(pd.DataFrame(rows), ["labelling", "variant"], columns)
    table["paper_test1_visible_accuracy"] = np.nan
    for (labelling, variant), value in paper.VISIBLE_1.items():
        chosen = (table["labelling"] == labelling) & (table["variant"] == variant)
        table.loc[chosen, "paper_test1_visible_accuracy"] = value
    return table
