"""Study of Tomic et al. 2019: tables from the results of its tasks, and its page beside the paper's results."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.cityscapes import CITYSCAPES, SKY, image_classes, segmentation_table
from mlsroad_pipeline.algorithms.metrics.confusion import scores as figures_of
from mlsroad_pipeline.algorithms.metrics.scores import CLASS_METRICS, labelling_scores
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.shared.studies.study import Shown, Stage, Study, Tables, mean_and_spread, paper_table
from mlsroad_pipeline.papers.tomic2019.study import plan as stages
from mlsroad_pipeline.papers.tomic2019.study.figures import CAPTIONS, study_figures
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
    method_name,
)

Runs = Mapping[str, FusionScores]
"""``<forest>.<street>`` to the scores of the fusion."""

VISIBLE_1 = {("features", "printed_forest"): 0.724, ("images", "hidden_points"): 0.885}
"""Overall accuracy of both methods on the visible points of test set 1 in the paper (section 4, third conclusion)."""

OVERALL = ("overall_accuracy", "kappa", "mean_f1")


def _labellings() -> list[tuple[str, str]]:
    """Return forest and labelling of every row of the tables, in their order."""
    first = [(PRINTED, FEATURES), (OWN, FEATURES), (PRINTED, IMAGES)]
    return first + [(forest, labelling) for forest in MAIN for labelling in (RULE, POOL, BY_F1)]


def study_tables(
    plan: StudyPlan, by_features: SceneCollection, by_images: SceneCollection, fused: SceneCollection
) -> dict[str, pd.DataFrame]:
    """Make the tables: means over the surveys, with the standard deviation as ``_spread``.

    Splits of the scores are test set 2 of each survey, all points and visible points.
    """
    stored = fused.load_all("results")
    runs = {key: FusionScores.from_arrays(arrays) for key, arrays in stored.items()}
    cameras = {street: stored[f"{PRINTED}.{street}"]["cameras"] for street in plan.streets}
    pixels = by_images.part("pixels")
    each = pd.concat(
        [
            labelling_scores(
                runs[f"{forest}.{street}"].confusions[f"{labelling}.{split}"],
                method=method_name(labelling, forest), split=f"{street}.{split}", classes=plan.scheme.classes,
            ).assign(street=street, part=split)
            for split in (ALL_POINTS, VISIBLE)
            for forest, labelling in _labellings()
            for street in plan.streets
        ],
        ignore_index=True,
    )  # fmt: skip
    whole = each[each["part"] == ALL_POINTS]
    fusions = [method_name(labelling, forest) for forest in MAIN for labelling in (RULE, POOL)]
    return {
        "scores": each.drop(columns=["street", "part"]),
        "table_1": _segmentation(plan, {street: pixels[street].load()["matrix"] for street in plan.streets}),
        "table_2": _method_f1(plan, runs),
        "table_3": _by_class(whole, list(MAIN), FEATURES),
        "table_4": _by_class(whole, [method_name(IMAGES, "")], IMAGES),
        "table_5": _by_class(whole, fusions, RULE),
        "overall": _overall(each),
        "gains": _gains(plan, runs),
        "cameras": _camera_f1(plan, runs, cameras),
        "redundancy": _redundancy(plan, runs),
        "forests": _forests(plan, runs, by_features.load_all("facts")),
        "variants": _variants(plan, runs),
    }


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
    return table.merge(_images_of_paper(), on=["kind", "name"], how="left")


def _method_f1(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = []
    for forest in MAIN:
        for street in plan.streets:
            first, second = runs[f"{forest}.{street}"].method_f1
            rows += [
                (forest, name, float(a), float(b), float(b > a))
                for name, a, b in zip(plan.scheme.classes, first, second, strict=True)
            ]
    table = pd.DataFrame(rows, columns=["features", "class", "features_f1", "images_f1", "prefer_images"])
    groups = ["features", "class"]
    chosen = table.groupby(groups, sort=False)["prefer_images"].sum().astype(int).reset_index()
    means = _spread(table, groups, ["features_f1", "images_f1"]).merge(chosen, on=groups)
    return means.merge(paper_table("tomic2019", "table_2"), on="class", how="left")


def _by_class(scores: pd.DataFrame, methods: Sequence[str], printed: str) -> pd.DataFrame:
    """Return one row per method and class, with the paper's values next to ours."""
    rows = scores[scores["method"].isin(methods) & (scores["class"] != "all")]
    wide = rows.pivot(index=["method", "class", "street"], columns="metric", values="value").reset_index()
    order = {name: k for k, name in enumerate(methods)}
    places = {name: k for k, name in enumerate(dict.fromkeys(rows["class"]))}
    wide = wide.sort_values(["method", "class"], key=lambda c: c.map(order | places), kind="stable")
    paper = paper_scores(printed)[["class", *CLASS_METRICS]].rename(columns={m: f"paper_{m}" for m in CLASS_METRICS})
    return _spread(wide, ["method", "class"], CLASS_METRICS).merge(paper, on="class", how="left")


def paper_scores(labelling: str) -> pd.DataFrame:
    """Return the scores of Table 3, 4 or 5; the class `all` has overall accuracy, kappa and the mean F1."""
    table = paper_table("tomic2019", "tables_3_to_5")
    own = table[table["method"] == labelling].drop(columns="method")
    known = own["f1"].dropna()
    return own.assign(mean_f1=(sum(known) / len(known)) if len(known) else np.nan)


def _images_of_paper() -> pd.DataFrame:
    """Return Table 1 by classes of points and by categories."""
    table = paper_table("tomic2019", "table_1")
    iou = table[table["kind"] == "cityscapes"].set_index("name")["paper"].to_dict()
    rows: list[tuple[str, str, float, str]] = []
    for name in dict.fromkeys(becomes or SKY for _, becomes in CITYSCAPES.values()):
        own = [key for key, (_, becomes) in CITYSCAPES.items() if (becomes or SKY) == name]
        listed = ", ".join(f"{key} {iou[key]:.3f}" for key in own)
        rows.append(("class", name, sum(iou[key] for key in own) / len(own), listed))
    others = table[table["kind"] != "cityscapes"]
    others = others.assign(paper_classes=np.where(others["kind"] == "class", "all 19", ""))
    return pd.concat([pd.DataFrame(rows, columns=others.columns), others])


def _overall(each: pd.DataFrame) -> pd.DataFrame:
    rows = each[(each["class"] == "all") & each["metric"].isin(OVERALL)]
    order = list(dict.fromkeys(zip(rows["part"], rows["method"], strict=True)))
    wide = rows.pivot(index=["part", "method", "street"], columns="metric", values="value").reset_index()
    table = _spread(wide, ["part", "method"], OVERALL).set_index(["part", "method"]).loc[order].reset_index()
    printed = {PRINTED: FEATURES, method_name(IMAGES, ""): IMAGES, method_name(RULE, PRINTED): RULE}
    paper = {method: paper_scores(name).set_index("class").loc["all"] for method, name in printed.items()}
    for metric in OVERALL:
        values = {method: float(cast(float, row[metric])) for method, row in paper.items()}
        table[f"paper_{metric}"] = table["method"].map(values).where(table["part"] == ALL_POINTS)
    return table


def _gains(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = []
    for forest in MAIN:
        for street in plan.streets:
            confusions = runs[f"{forest}.{street}"].confusions
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


def _camera_f1(plan: StudyPlan, runs: Runs, cameras: Mapping[str, NDArray[np.str_]]) -> pd.DataFrame:
    rows = [
        (str(camera), name, float(value))
        for street in plan.streets
        for camera, values in zip(cameras[street], runs[f"{PRINTED}.{street}"].camera_f1, strict=True)
        for name, value in zip(plan.scheme.classes, values, strict=True)
    ]
    return _spread(pd.DataFrame(rows, columns=["camera", "class", "f1"]), ["camera", "class"], ["f1"])


def _redundancy(plan: StudyPlan, runs: Runs) -> pd.DataFrame:
    rows = []
    for forest in MAIN:
        total = np.sum([runs[f"{forest}.{street}"].redundancy for street in plan.streets], axis=0)
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
            "pool_penalty": runs[f"{forest}.{street}"].penalty,
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
                confusions = runs[f"{name}.{street}"].confusions
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
    for (labelling, variant), value in VISIBLE_1.items():
        chosen = (table["labelling"] == labelling) & (table["variant"] == variant)
        table.loc[chosen, "paper_test1_visible_accuracy"] = value
    return table


def study_facts(plan: StudyPlan) -> dict[str, Any]:
    """Return the surveys of the runs."""
    scale, division = plan.scale, plan.division
    return {
        "scale": plan.study.scale,
        "surveys": f"{len(scale.seeds)} of {division.length:g} m, seeds {list(scale.seeds)}",
        "division": "training half of method 1, test set 1 (a quarter), test set 2 (a quarter), "
        f"gaps of {division.gap:g} m",
        "training images of the network": f"streets of seeds {list(scale.photograph_seeds)}",
    }


_SPREAD = "Mean and standard deviation over the surveys; paper_ columns: the paper's values on a real street."
PAGE = {
    "table_1": ("Table 1: IoU of segmented images", "Paper: Cityscapes, means over its classes."),
    "table_2": ("Table 2: F1 on test set 1", "prefer_images: surveys on which F1 of the images is higher."),
    "table_3": ("Table 3: method 1 on test set 2", _SPREAD),
    "table_4": ("Table 4: images on test set 2", f"{_SPREAD} Unseen points count as errors."),
    "table_5": ("Table 5: fusions on test set 2", _SPREAD),
    "overall": ("Overall", "fusion_by_f1 compares only F1 of the two labels; see docs/methods/fusion.md."),
    "gains": ("Gains", "Error of a fusion relative to the better single method, and gain in mean F1 over it."),
    "cameras": ("Cameras: F1 on test set 1", ""),
    "redundancy": ("Redundancy", "Labellers are method 1 and three cameras."),
    "forests": ("Forests", ""),
    "variants": (
        "Variants",
        "Method 1 as printed, with the distance of Papon et al. 2013, without detrending, and with regularised "
        "labels; images by a depth buffer and by hidden point removal.",
    ),
}
"""Name of each table of the page to its title and note."""


def study_page(plan: StudyPlan, tables: Tables) -> list[Shown]:
    """Return the tables of the page."""
    return [Shown(title, tables[name].round(3), note) for name, (title, note) in PAGE.items()]


STUDY = Study(
    "tomic2019",
    "Tomic et al. 2019 on simulated surveys",
    parameters=(
        "classes", "ground_removal", "supervoxelise", "features", "detrended_forest", "image_labels", "fusion"
    ),
    plan=stages.plan_study,
    stages=[
        Stage("make_tomic2019_surveys", stages.make_surveys, [], "streets"),
        Stage("make_tomic2019_photographs", stages.make_photographs, [], "photographs"),
        Stage("train_tomic2019_network", stages.train_network, ["photographs"], "networks"),
        Stage("label_tomic2019_by_features", stages.label_by_features, ["streets"], "by_features"),
        Stage("label_tomic2019_by_images", stages.label_by_images, ["streets", "networks"], "by_images"),
        Stage("fuse_tomic2019_surveys", stages.fuse_surveys, ["streets", "by_features", "by_images"], "runs"),
    ],
    results=["by_features", "by_images", "runs"],
    tables=("scores", *PAGE),
    tabulate=study_tables,
    captions=CAPTIONS,
    draw=study_figures,
    facts=study_facts,
    page=study_page,
    shown=["plan", "streets", "by_features", "by_images", "runs"],
)  # fmt: skip
