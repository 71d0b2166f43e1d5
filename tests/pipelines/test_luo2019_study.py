"""Study of luo2019 at its fast scale: tables that agree with each other."""

import numpy as np
import pandas as pd
import pytest
from helpers.wiring import make_project, run

from mlsroad_pipeline.papers.luo2019.study import efficiency
from mlsroad_pipeline.papers.luo2019.study.plan import METHODS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

FAST = {
    "luo2019_study": {"scale": "fast"},
    "simulated_objects": {"scale": "fast"},
    "jointnet": {"training": {"n_turns": 2, "regression_copies": 2}},
    "jointnet_tuned": {"training": {"n_turns": 2}},
    "pointnet": {"n_turns": 2},
    "execution": {"backend": "sequential"},
}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = make_project(tmp_path_factory.mktemp("luo2019"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(efficiency, "STEPS", 2)  # timing takes seconds per network
        run(folder, "luo2019_study", **FAST)
    return folder


def table(project, name):
    return pd.read_csv(project / f"data/08_reporting/luo2019_study/{name}.csv")


def test_splits_share_no_street(project):
    streets = {}
    for split in ("train", "validation", "test"):
        with np.load(project / f"data/05_model_input/simulated_objects/hdr9.{split}/result.npz") as found:
            streets[split] = set(found["street"].tolist())
            assert np.isfinite(found["xyz"]).all() and np.diff(found["indptr"]).max() <= 1000
    assert streets["train"] | streets["validation"] | streets["test"] <= {11, 12, 13}
    assert sum(map(len, streets.values())) == len(set().union(*streets.values()))
    composition = pd.read_csv(project / "data/08_reporting/simulated_objects.csv")
    assert (composition["objects"] == composition[["wanted", "found"]].min(axis=1)).all()


def test_tables_agree_with_the_scores(project):
    two, scores = table(project, "table_2"), table(project, "scores").set_index(["method", "class", "metric"])["value"]
    assert two["method"].tolist() == list(METHODS)
    robust = table(project, "robustness").set_index(["method", "disturbance"])
    for row in two.itertuples():
        assert row.accuracy == pytest.approx(scores[row.method, "all", "overall_accuracy"])
        assert row.f1 == pytest.approx(scores[row.method, "all", "mean_f1"])
        assert row.accuracy == pytest.approx(robust.loc[(row.method, "clean"), "accuracy"].item())
    confusions = table(project, "confusion_counts")
    counted = confusions.groupby(["method", "level"])["objects"].sum()
    assert set(counted) == {two["objects"].iloc[0]} and len(counted) == 16  # four networks, clean and three test sets
    f1 = table(project, "sub_networks")
    for (method, level), rows in confusions.groupby(["method", "level"]):
        own = f1[(f1["method"] == method) & (f1["level"] == level)]
        assert (rows["class"] == rows["recognised"]).any() == (own["f1"] > 0).any()
    apart = table(project, "differences").set_index(["method", "disturbance"])
    f1 = [robust.loc[(method, "noise"), "mean_f1"].item() for method in ("shot", "jointnet")]
    assert apart.loc[("shot", "noise"), "difference"].item() == pytest.approx(f1[0] - f1[1])


def test_sizes_times_and_settings_are_told(project):
    four = table(project, "table_4").set_index("method")
    assert four.loc[["hierarchy_descriptor", "spin_image", "shot"], "dimension"].tolist() == [100, 153, 352]
    assert four.loc["jointnet", "model_mb"] < 5 < four.loc["jointnet", "paper_model_mb"] == 223
    assert (
        four["footprint_bytes"].dropna().tolist() == four["paper_footprint_bytes"].dropna().tolist() == [400, 612, 1408]
    )
    published = four.loc["pointnet_published"]
    assert published["weights_mb"] == pytest.approx(13.9, abs=0.2)  # 3.47 million weights
    assert published["with_slots_mb"] == pytest.approx(published["paper_model_mb"], rel=0.02)  # 42 MB
    assert four.loc["jointnet", "with_slots_mb"] == pytest.approx(2 * four.loc["jointnet", "weights_mb"])
    assert table(project, "size_grid")["sizes"].unique().tolist() == ["4x4x4"]
    one = table(project, "table_1").set_index("method")
    assert (one["memory_mb"] > one["model_mb"]).all() and (one[["backward_ms", "forward_ms"]] > 0).all(axis=None)
    tried = table(project, "tuning")
    assert tried["chosen"].sum() == 1
    assert tried.loc[tried["chosen"], "validation_accuracy"].item() == tried["validation_accuracy"].max()
    assert set(table(project, "training")["disturbance"]) == {"clean", "noise", "labels", "combined"}
    page = (project / "data/08_reporting/luo2019_study/report.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 7
