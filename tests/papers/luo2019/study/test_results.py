"""Tables of the study of luo2019 from planted class scores."""

from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.metrics import f1_score

from mlsroad_pipeline.papers.luo2019.study.plan import CLEAN, MAIN, METHODS, SYDNEY, UNDISTURBED, StudyRun
from mlsroad_pipeline.papers.luo2019.study.results import _Tables


def test_table_three_has_the_mean_of_the_folds_and_the_figure_of_all_folds_together(rng):
    runs = [
        StudyRun(MAIN, SYDNEY, method, method, (), (), f"{SYDNEY}.fold{k}", {CLEAN: UNDISTURBED}, 1)
        for k in range(3)
        for method in METHODS
    ]
    results = {
        run.key: {"scores": rng.random((1, 20, 4)), "label": rng.integers(0, 4, 20), "street": np.arange(20),
                  "seconds": np.zeros(1)}
        for run in runs
    }  # fmt: skip
    plan = SimpleNamespace(of_group=lambda group: runs, schemes={SYDNEY: range(4)})
    found = _Tables(plan, results, {}, {}).table_three().set_index("method")
    assert {*METHODS, "LightNet"} <= set(found.index)
    label, predicted = (
        [one(results[run.key]) for run in runs if run.method == "jointnet"]
        for one in (lambda r: r["label"], lambda r: r["scores"][0].argmax(axis=1))
    )
    each = [f1_score(*fold, average="weighted", zero_division=0) for fold in zip(label, predicted, strict=True)]
    row = found.loc["jointnet"]
    assert row["weighted_f1"] == pytest.approx(np.mean(each)) and row["paper"] == 0.749
    together = f1_score(np.concatenate(label), np.concatenate(predicted), average="weighted", zero_division=0)
    assert row["together"] == pytest.approx(together)
