"""Tables of Luo et al. 2016, section IV, from confusion matrices: Table III, intervals, Figures 7 to 11."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.metrics.confusion import scores
from mlsroad_pipeline.papers.shared.studies.study import holm, p_value, paired_interval, paper_table

CLASSES = ("road", "grass", "palm tree", "cycas", "brushwood", "light pole", "vehicle")
"""The seven classes of Table I that means are taken over; `other` is excluded."""

OBJECTS = CLASSES[2:]
"""The five classes of objects, the only ones that shape-based recognition predicts."""

METRICS = ("precision", "recall", "f1")
MEANS = {"mean of seven": CLASSES, "mean of five": OBJECTS}
"""Means over classes, as rows of `class`: over all classes that the paper scores, and over the objects among them."""

Matrices = Mapping[str, Mapping[str, NDArray[np.int64]]]
"""Repetition to method to confusion matrix."""


def repetition_scores(
    matrices: Matrices, *, classes: Sequence[str], given: Mapping[str, Sequence[str]] | None = None
) -> pd.DataFrame:
    """Score every method of every repetition per class and average over classes.

    `given` has the classes of methods that predict only some; the scores of their other classes are NaN.
    """
    missing = [name for name in CLASSES if name not in classes]
    if missing:
        raise DataError(f"the scheme lacks the classes {', '.join(missing)} of luo2016")
    places = [list(classes).index(name) for name in CLASSES]
    rows = []
    for repetition, methods in matrices.items():
        for method, matrix in methods.items():
            figures = scores(matrix)
            mine = CLASSES if given is None or method not in given else tuple(given[method])
            for metric in METRICS:
                values = np.where(figures.support > 0, getattr(figures, metric), np.nan)[places]
                shown = np.where([name in mine for name in CLASSES], values, np.nan)
                rows += [(repetition, method, n, metric, v) for n, v in zip(CLASSES, shown, strict=True)]
                for mean, members in MEANS.items():
                    chosen = [CLASSES.index(name) for name in members]
                    able = all(name in mine for name in members)
                    known = values[chosen][~np.isnan(values[chosen])]
                    rows.append((repetition, method, mean, metric, known.mean() if able and len(known) else np.nan))
    return pd.DataFrame(rows, columns=["repetition", "method", "class", "metric", "value"])


def table_three(scored: pd.DataFrame) -> pd.DataFrame:
    """Return mean and spread over the repetitions next to the paper's Table III."""
    grouped = scored.groupby(["method", "class", "metric"], sort=False)["value"]
    table = grouped.agg(mean="mean", spread="std", repetitions="count").reset_index()
    paper = paper_table("luo2016", "table_3").melt(["method", "metric"], var_name="class", value_name="paper")
    paper = pd.concat([paper, paper.assign(method=paper["method"] + "_printed")])
    means = [
        paper[paper["class"].isin(members)]
        .groupby(["method", "metric"], sort=False)["paper"]
        .agg(lambda values: values.mean(skipna=False))
        .reset_index()
        .assign(**{"class": mean})
        for mean, members in MEANS.items()
    ]
    return table.merge(pd.concat([paper, *means]), on=["method", "class", "metric"], how="left")


def paired_differences(
    scored: pd.DataFrame, *, reference: str = "patch_graph_mrf", confidence: float = 0.95
) -> pd.DataFrame:
    """Compare the mean F1 of every method with that of a reference, repetition by repetition."""
    if reference not in set(scored["method"]):
        raise DataError(
            f"reference method {reference} was not scored (methods: {', '.join(sorted(set(scored['method'])))})"
        )
    rows = []
    for mean in MEANS:
        chosen = scored[(scored["class"] == mean) & (scored["metric"] == "f1")]
        wide = chosen.pivot(index="repetition", columns="method", values="value")
        for method in dict.fromkeys(chosen["method"]):
            centre, low, high, n = paired_interval((wide[method] - wide[reference]).to_numpy(), confidence)
            if method != reference and n:
                rows.append((method, mean, centre, low, high, n))
    return pd.DataFrame(rows, columns=["method", "mean_over", "difference", "low", "high", "repetitions"])


def all_pairs(scored: pd.DataFrame, *, confidence: float = 0.95) -> pd.DataFrame:
    """Compare the mean F1 of every two methods; a pair is `sure` if its interval does not contain 0.

    `p` is that of the paired t-test after Holm's correction for all pairs. The mean is that of seven classes, or of
    five where one of the two does not predict the others.
    """
    methods = list(dict.fromkeys(scored["method"]))
    f1 = scored[scored["metric"] == "f1"]
    rows = []
    for place, first in enumerate(methods):
        for second in methods[place + 1 :]:
            for mean in MEANS:
                wide = f1[f1["class"] == mean].pivot(index="repetition", columns="method", values="value")
                apart = (wide[first] - wide[second]).to_numpy()
                centre, low, high, n = paired_interval(apart, confidence)
                if n:
                    rows.append((first, second, mean, centre, low, high, n, low > 0 or high < 0, p_value(apart)))
                    break
    columns = ["method", "other", "mean_over", "difference", "low", "high", "repetitions", "sure", "p"]
    pairs = pd.DataFrame(rows, columns=columns)
    return pairs.assign(p=holm(pairs["p"].to_numpy(np.float64)))


def sensitivity_table(
    matrices: Mapping[float, Matrices], facts: Mapping[float, pd.DataFrame], *, classes: Sequence[str]
) -> pd.DataFrame:
    """Score a method at every value of a parameter."""
    rows = []
    for value in sorted(matrices):
        scored = repetition_scores(matrices[value], classes=classes)
        f1 = scored[scored["metric"] == "f1"].groupby("class", sort=False)["value"]
        means = facts[value][["train_seconds", "objective"]].mean()
        spread = f1.std().add_suffix(" spread")
        rows.append({"value": value, **f1.mean().to_dict(), **means.to_dict(), **spread.to_dict()})
    spreads = [f"{name} spread" for name in (*CLASSES, *MEANS)]
    return pd.DataFrame(rows, columns=["value", *CLASSES, *MEANS, "train_seconds", "objective", *spreads])


def times_table(facts: pd.DataFrame) -> pd.DataFrame:
    """Average the CPU time of every method over the repetitions."""
    grouped = facts.groupby("method", sort=False)
    table = grouped[["train_seconds", "label_seconds"]].mean()
    return table.assign(trainings=grouped.size()).reset_index()
