"""Study of tomic2019 at its fast scale: tables that agree with each other."""

import pandas as pd
import pytest
from helpers.wiring import make_project, run

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

FAST = {
    "tomic2019_study": {"scale": "fast"},
    "detrended_forest": {"fallback_trees": 5},
    "image_labels": {"magnification": 1.4},
    "execution": {"backend": "sequential"},
}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = make_project(tmp_path_factory.mktemp("tomic2019"))
    run(folder, "tomic2019_study", **FAST)
    return folder


def table(project, name):
    return pd.read_csv(project / f"data/08_reporting/tomic2019_study/{name}.csv")


def test_tables_agree_with_the_scores(project):
    scores = table(project, "scores").set_index(["method", "split", "class", "metric"])["value"]
    forests = ["printed_forest", "detrended_forest"]
    fusions = [f"{name}.{forest}" for forest in forests for name in ("fusion", "fusion_pool", "fusion_by_f1")]
    overall = table(project, "overall").set_index(["part", "method"])
    assert list(overall.loc["test2"].index) == [*forests, "image_labels", *fusions]
    for (part, method), row in overall.iterrows():
        assert row["overall_accuracy"] == pytest.approx(scores[method, f"seed_1.{part}", "all", "overall_accuracy"])
    for name, methods in (("table_3", forests), ("table_4", ["image_labels"])):
        rows = table(project, name)
        assert list(dict.fromkeys(rows["method"])) == methods
        for row in rows.itertuples():
            assert row.f1 == pytest.approx(scores[row.method, "seed_1.test2", row._2, "f1"], nan_ok=True)
    gains = table(project, "gains").iloc[0]
    assert gains["overall_accuracy"] == pytest.approx(
        overall.loc[("test2", "fusion.printed_forest"), "overall_accuracy"]
    )
    alone = overall.loc["test2"].loc[["printed_forest", "image_labels"], "overall_accuracy"].max()
    assert gains["error_ratio"] == pytest.approx((1 - gains["overall_accuracy"]) / (1 - alone))


def test_variants_of_both_methods_stand_side_by_side(project):
    variants = table(project, "variants").set_index(["labelling", "variant"])
    printed = ["printed_forest", "printed_papon", "printed_plain", "printed_smoothed", "printed_plain_smoothed"]
    assert list(variants.loc["features"].index) == [*printed, "detrended_forest"]
    assert list(variants.loc["images"].index) == ["depth_buffer", "hidden_points"]
    overall = table(project, "overall").set_index(["part", "method"])
    assert variants.loc[("features", "printed_forest"), "kappa"] == pytest.approx(
        overall.loc[("test2", "printed_forest"), "kappa"]
    )
    assert variants.loc[("images", "depth_buffer"), "visible_accuracy"] == pytest.approx(
        overall.loc[("test2_visible", "image_labels"), "overall_accuracy"]
    )
    assert variants.loc["images", "seen"].nunique() == 2  # the two methods see different points
    paper = variants["paper_test1_visible_accuracy"].dropna()
    assert paper.to_dict() == {("features", "printed_forest"): 0.724, ("images", "hidden_points"): 0.885}
    assert variants.loc[("features", "printed_forest"), "test1_visible_accuracy"] > 0.3


def test_the_papers_figures_stand_beside(project):
    overall = table(project, "overall").set_index(["part", "method"])["paper_overall_accuracy"]
    assert overall["test2"].dropna().to_dict() == {
        "printed_forest": 0.721, "image_labels": 0.649, "fusion.printed_forest": 0.868
    }  # fmt: skip
    five = table(project, "table_5").set_index(["method", "class"])
    assert five.loc[("fusion.printed_forest", "building"), "paper_f1"] == 0.881
    one = table(project, "table_1").set_index(["kind", "name"])
    assert one.loc[("category", "flat"), "paper"] == 0.976 and one.loc[("class", "mean"), "paper"] == 0.651


def test_the_report_shows_figures_and_redundancy_counts_every_point(project):
    counts = table(project, "redundancy").groupby("features")[["points", "share"]].sum()
    assert counts["points"].nunique() == 1 and counts["share"].tolist() == pytest.approx([1, 1])
    page = (project / "data/08_reporting/tomic2019_study/report.html").read_text(encoding="utf-8")
    assert page.count("data:image/") == 5
