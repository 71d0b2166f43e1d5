"""Study of yu2016 at its fast scale: tables that agree with each other."""

import pandas as pd
import pytest
from helpers.wiring import make_project, run

from mlsroad_pipeline.papers.yu2016.study.parameters import DETECTORS, SEGMENTATIONS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

FAST = {
    "yu2016_study": {"scale": "fast"},
    "detection": {"classes": ["light pole", "traffic sign", "car"], "min_points": 10},
    "visual_words": {"without_intensity": False},
    "execution": {"backend": "sequential"},
}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = make_project(tmp_path_factory.mktemp("yu2016"))
    run(folder, "yu2016_study", **FAST)
    return folder


def table(project, name):
    return pd.read_csv(project / f"data/08_reporting/yu2016_study/{name}.csv")


def test_every_segmentation_and_detector_is_scored(project):
    segmentation = table(project, "segmentation")
    assert list(segmentation["method"]) == list(SEGMENTATIONS)
    coverage = segmentation.set_index("method")[["coverage", "weighted_coverage"]]
    published = ["normalized_cut_plain", "normalized_cut_printed"]
    assert coverage.drop(published).gt(0.1).all(axis=None)
    # The published cuts cluster at 0.15 m whatever the spacing, and these streets are sparse.
    assert (coverage.loc[published] < coverage.loc["normalized_cut_geometry"]).all(axis=None)
    assert coverage.loc[published].gt(0).all(axis=None)
    assert segmentation["seconds"].gt(0).all()
    five = table(project, "table_5")
    assert list(five["method"]) == list(DETECTORS)
    assert five["paper_f_score"].round(3).tolist() == [0.899, 0.916, 0.911, 0.923, 0.923, 0.923]


def test_tables_agree_with_the_scores(project):
    scores = table(project, "scores").set_index(["method", "split", "class", "metric"])["value"]
    for row in table(project, "table_2").itertuples():
        name = row._2
        assert row.found == scores[row.method, "RRS", name, "tp"]
        assert row.false == scores[row.method, "RRS", name, "fp"]
        assert row.objects == row.found + scores[row.method, "RRS", name, "fn"]
    three = table(project, "table_3")
    recall = three[(three["method"] == "visual_words") & (three["survey"] == "RRS") & (three["metric"] == "recall")]
    totals = table(project, "table_2").set_index(["method", "class"]).loc[("visual_words", "all")]
    assert recall["value"].item() == pytest.approx(totals["found"] / totals["objects"])
    assert recall["paper"].item() == 0.961


def test_streets_and_vocabularies_are_told(project):
    setup = table(project, "setup")
    assert setup["split"].tolist() == ["train", "test"] and setup["points"].gt(1000).all()
    training = table(project, "training").set_index("model")
    assert set(training.index) == {f"{detector}.RRS" for detector in DETECTORS}
    assert training.loc["visual_words.RRS", "words"] > 0 == training.loc["hough_forest.RRS", "words"]


def test_times_and_settings_are_told(project):
    times = table(project, "table_4").set_index("step")
    assert times.loc["all", "seconds"] == pytest.approx(times["seconds"].drop("all").sum())
    assert times.loc["all", "paper"] == pytest.approx(1728e6 / 2511 / 16)
    figure = table(project, "figure_12")
    assert figure["parameter"].tolist() == ["pattern", "words_per_group", "k"]
    page = (project / "data/08_reporting/yu2016_study/report.html").read_text(encoding="utf-8")
    assert "(0.961)" in page or "0.961" in page
    assert page.count("data:image/") == 2
