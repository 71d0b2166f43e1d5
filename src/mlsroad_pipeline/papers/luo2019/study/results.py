"""Tables of the study of Luo et al. 2019, made from the results of its runs."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.metrics.scores import recognition_scores
from mlsroad_pipeline.execution.collection import SceneCollection
from mlsroad_pipeline.papers.luo2019.study import plan as luo2019
from mlsroad_pipeline.papers.luo2019.study.runs import Recognised, TrainingFacts
from mlsroad_pipeline.papers.luo2019.study.scores import (
    area_under,
    mean_figures,
    paired_interval,
    precision_recall,
    street_confusions,
    weighted_f1,
)
from mlsroad_pipeline.papers.shared.studies.study import paper_table

Results = Mapping[str, Recognised]
"""Key of a run to its class scores."""

Facts = Mapping[str, TrainingFacts]
"""Key of a run to the facts of its training."""

LEVELS = ("level=1", "level=2", "level=3")
"""Test sets 1, 2 and 3 of the paper."""


class _Condition:
    """Joined class scores of several runs under one condition."""

    def __init__(self, runs: list[luo2019.StudyRun], results: Results, condition: str, n_classes: int) -> None:
        row = [list(run.conditions).index(condition) for run in runs]
        each = [results[run.key] for run in runs]
        self.n_classes = n_classes
        self.scores = np.concatenate([one["scores"][i] for i, one in zip(row, each, strict=True)])
        self.label = np.concatenate([one["label"] for one in each])
        # Objects from files have no street: their numbers must differ between folds.
        fold = {test: k << 32 for k, test in enumerate(dict.fromkeys(run.test for run in runs))}
        self.street = np.concatenate([f["street"] + fold[r.test] for r, f in zip(runs, each, strict=True)])
        self.seconds = sum(float(one["seconds"][i]) for i, one in zip(row, each, strict=True))

    def by_street(self) -> dict[int, NDArray[np.int64]]:
        return street_confusions(self.label, self.scores.argmax(axis=1), self.street, self.n_classes)

    def matrix(self) -> NDArray[np.int64]:
        return np.sum(list(self.by_street().values()), axis=0, dtype=np.int64)

    def curve(self) -> pd.DataFrame:
        threshold, precision, recall = precision_recall(self.scores, self.label)
        return pd.DataFrame({"threshold": threshold, "precision": precision, "recall": recall})


def study_tables(plan: luo2019.StudyPlan, runs: SceneCollection, networks: SceneCollection) -> dict[str, pd.DataFrame]:
    """Make the tables; scores are those of undisturbed objects, their splits are the sets.

    Figures 9 and 10 are `sub_networks` and `confusion_counts`, of networks without the measures.
    """
    made = _Tables(plan, runs.load_all("results"), runs.load_all("facts"), networks.load_all())
    efficiency = made.efficiency()
    sub_networks, confusions = made.sub_networks()
    sizes, curves_7 = made.variants(luo2019.SIZE)
    grid, _ = made.variants(luo2019.GRID)
    training, curves_14 = made.variants(luo2019.TRAINING)
    return {
        "scores": made.scores(),
        "table_1": _table_one(efficiency),
        "table_2": made.table_two(),
        "table_3": made.table_three(),
        "table_4": _table_four(efficiency),
        "sub_networks": sub_networks,
        "confusion_counts": confusions,
        "robustness": made.robustness(),
        "differences": made.differences(),
        "image_sizes": sizes.rename(columns={"disturbance": "view", "level": "size"}),
        "size_grid": grid.rename(columns={"disturbance": "kind", "level": "sizes"}),
        "training": training,
        "curves": pd.concat([curves_7.assign(figure=7), made.curves().assign(figure=11), curves_14.assign(figure=14)]),
        "tuning": made.tuning(),
    }


def _table_four(efficiency: pd.DataFrame) -> pd.DataFrame:
    """Return Table 4; the paper's PointNet has the published size, and a descriptor has four bytes per dimension."""
    table = efficiency[efficiency["method"].isin((*luo2019.BASELINES, luo2019.PUBLISHED, luo2019.JOINTNET))].copy()
    table.insert(2, "footprint_bytes", 4 * table["dimension"])
    paper = paper_table("luo2019", "table_4")
    paper["method"] = paper["method"].replace({luo2019.BASELINES[-1]: luo2019.PUBLISHED})
    return table.merge(paper, on="method", how="left")


def _table_one(efficiency: pd.DataFrame) -> pd.DataFrame:
    chosen = efficiency[efficiency["method"].isin((*luo2019.SUB_NETWORKS, luo2019.JOINTNET))].drop(columns="dimension")
    paper = paper_table("luo2019", "table_1").set_index("method")
    rows = paper.reindex(["jointnet" if m == luo2019.JOINTNET else "sub-networks" for m in chosen["method"]])
    return pd.concat([chosen.reset_index(drop=True), rows.reset_index(drop=True)], axis=1)


class _Tables:
    """Builder of the tables."""

    def __init__(
        self, plan: luo2019.StudyPlan, results: Results, facts: Facts, networks: Mapping[str, Mapping[str, NDArray]]
    ) -> None:
        self.plan, self.results, self.facts, self.networks = plan, results, facts, networks
        self.main = plan.of_group(luo2019.MAIN)
        self.sets = tuple(dict.fromkeys(run.dataset for run in self.main))

    def _of(self, name: str, method: str) -> list[luo2019.StudyRun]:
        return [run for run in self.main if run.dataset == name and run.method == method]

    def _under(self, name: str, method: str, condition: str) -> _Condition:
        return _Condition(self._of(name, method), self.results, condition, len(self.plan.schemes[name]))

    def scores(self) -> pd.DataFrame:
        tables = [
            recognition_scores(
                self._under(name, method, luo2019.CLEAN).matrix(),
                method=method,
                split=name,
                classes=self.plan.schemes[name].classes,
            )
            for name in self.sets
            for method in luo2019.METHODS
        ]
        return pd.concat(tables, ignore_index=True)

    def table_two(self) -> pd.DataFrame:
        rows = []
        for name in self.sets:
            for method in luo2019.METHODS:
                runs = self._of(name, method)
                # The paper's values for Sydney are those of the last fold.
                runs = [run for run in runs if name != luo2019.SYDNEY or run.test == runs[-1].test]
                clean = _Condition(runs, self.results, luo2019.CLEAN, len(self.plan.schemes[name]))
                objects = len(clean.label) // len(self.plan.scale.seeds)
                rows.append({"set": name, "method": method, "objects": objects, **mean_figures(clean.matrix())})
        return pd.DataFrame(rows).merge(paper_table("luo2019", "table_2"), on=["set", "method"], how="left")

    def table_three(self) -> pd.DataFrame:
        """Return the weighted F1 of the folds: their mean, as in the paper, and that of all folds together."""
        columns, rows = ["method", "weighted_f1", "together"], []
        if luo2019.SYDNEY not in self.sets:
            return pd.DataFrame(columns=[*columns, "paper"])
        n_classes = len(self.plan.schemes[luo2019.SYDNEY])
        for method in luo2019.METHODS:
            folds = [
                _Condition([run], self.results, luo2019.CLEAN, n_classes).matrix()
                for run in self._of(luo2019.SYDNEY, method)
            ]
            rows.append((method, np.mean([weighted_f1(fold) for fold in folds]), weighted_f1(np.sum(folds, axis=0))))
        return pd.DataFrame(rows, columns=columns).merge(paper_table("luo2019", "table_3"), on="method", how="outer")

    def efficiency(self) -> pd.DataFrame:
        rows = []
        for method in (*luo2019.METHODS, luo2019.PUBLISHED):
            network = self.networks.get(method)
            facts = [self.facts[run.key] for run in self.main if run.method == method]
            weights = None if network is None else float(network["weight_bytes"]) / 1e6
            slots = (
                3 if method in (luo2019.BASELINES[-1], luo2019.PUBLISHED) else 2
            )  # Adam has two slots for a weight, momentum one
            row: dict[str, Any] = {
                "method": method,
                "dimension": int(facts[0]["dimension"]) or None if facts else None,
                "model_mb": max(float(f["model_bytes"]) for f in facts) / 1e6 if facts else weights,
                "weights_mb": weights,
                "with_slots_mb": None if weights is None else slots * weights,
                "memory_mb": None if network is None else float(network["memory_bytes"]) / 1e6,
                "backward_ms": None if network is None else float(network["backward_ms"]),
                "forward_ms": None if network is None else float(network["forward_ms"]),
            }
            for name in self.plan.sets if facts else ():
                clean = self._under(name, method, luo2019.CLEAN)
                row[f"{name}_ms_per_object"] = 1000 * clean.seconds / max(len(clean.label), 1)
                trained = [self.facts[run.key] for run in self._of(name, method)]
                row[f"{name}_train_s"] = float(np.mean([f["train_seconds"] for f in trained]))
            rows.append(row)
        return pd.DataFrame(rows)

    def sub_networks(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        name, rows, counts = self.plan.sets[0], [], []
        classes = self.plan.schemes[name].classes
        for level in (luo2019.CLEAN, *LEVELS):
            for method in (*luo2019.SUB_NETWORKS, luo2019.JOINTNET):
                runs = [run for run in self.plan.of_group(luo2019.ALONE) if run.method == method]
                matrix = _Condition(runs, self.results, level, len(classes)).matrix()
                table = recognition_scores(matrix, method=method, split=level, classes=classes)
                mine = table[(table["metric"] == "f1") & (table["support"] > 0)]
                rows.append(mine[["split", "method", "class", "value", "support"]])
                counts += [
                    (level, method, classes[i], classes[j], int(matrix[i, j])) for i, j in np.argwhere(matrix > 0)
                ]
        f1 = pd.concat(rows, ignore_index=True).rename(columns={"split": "level", "value": "f1"})
        return f1, pd.DataFrame(counts, columns=["level", "method", "class", "recognised", "objects"])

    def robustness(self) -> pd.DataFrame:
        rows = []
        for name in self.sets:
            for method in luo2019.METHODS:
                for condition in self.plan.scale.conditions():
                    figures = mean_figures(self._under(name, method, condition).matrix())
                    rows.append({"set": name, "method": method, **_level(condition), **_chosen(figures)})
        return pd.DataFrame(rows)

    def differences(self) -> pd.DataFrame:
        rows = []
        for name in self.sets:
            for condition in self.plan.scale.conditions():
                streets = {m: self._under(name, m, condition).by_street() for m in luo2019.METHODS}
                order = sorted(streets[luo2019.JOINTNET])
                own = [streets[luo2019.JOINTNET][s] for s in order]
                for method in luo2019.METHODS:
                    if method == luo2019.JOINTNET:
                        continue
                    other = [streets[method][s] for s in order]
                    apart = paired_interval(other, own, seed=self.plan.study.seed)
                    rows.append((name, *_level(condition).values(), method, *apart, len(order)))
        columns = ["set", "disturbance", "level", "method", "difference", "low", "high", "streets"]
        return pd.DataFrame(rows, columns=columns)

    def variants(self, group: str) -> tuple[pd.DataFrame, pd.DataFrame]:
        rows, curves = [], []
        for run in self.plan.of_group(group):
            for condition in run.conditions:
                one = _Condition([run], self.results, condition, len(self.plan.schemes[run.dataset]))
                curve = one.curve()
                names = {"set": run.dataset, **_level(run.setting), "tested_on": condition}
                area = area_under(curve["precision"].to_numpy(), curve["recall"].to_numpy())
                rows.append({**names, **_chosen(mean_figures(one.matrix())), "average_precision": area})
                curves.append(curve.assign(set=run.dataset, setting=run.setting, tested_on=condition))
        return pd.DataFrame(rows), pd.concat(curves, ignore_index=True) if curves else pd.DataFrame()

    def curves(self) -> pd.DataFrame:
        curves = [
            self._under(name, method, luo2019.CLEAN).curve().assign(set=name, setting=method, tested_on=luo2019.CLEAN)
            for name in self.sets
            for method in luo2019.METHODS
        ]
        return pd.concat(curves, ignore_index=True)

    def tuning(self) -> pd.DataFrame:
        rows = []
        for run in self.main:
            facts = self.facts[run.key]
            if len(run.settings) > 1:
                settings = self.plan.scale.tuning[run.method]
                rows += [
                    (run.dataset, run.method, run.seed, str(dict(setting)), float(accuracy), i == int(facts["chosen"]))
                    for i, (setting, accuracy) in enumerate(zip(settings, facts["tried"], strict=True))
                ]
        columns = ["set", "method", "seed", "setting", "validation_accuracy", "chosen"]
        return pd.DataFrame(rows, columns=columns)


def _level(name: str) -> dict[str, Any]:
    """Split a name such as ``noise=0.02`` into disturbance and level; the level is 0 if there is none."""
    kind, _, value = name.partition("=")
    return {"disturbance": kind, "level": (value if "x" in value else float(value)) if value else 0.0}


def _chosen(figures: Mapping[str, float]) -> dict[str, float]:
    return {"accuracy": figures["accuracy"], "mean_f1": figures["f1"]}
