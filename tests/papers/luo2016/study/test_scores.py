"""Tables of the study of luo2016: closed forms, SciPy and the averages of the paper."""

import numpy as np
import pandas as pd
import pytest
from references.patches import SCHEME
from scipy import stats

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.papers.luo2016.patch_graph.classifier import PatchGraphParameters
from mlsroad_pipeline.papers.luo2016.study.plan import StudyParameters, StudyScale
from mlsroad_pipeline.papers.luo2016.study.runs import count_street
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
from mlsroad_pipeline.papers.luo2016.study.study import by_step, scores_frame, table_one, wide_table
from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
from mlsroad_pipeline.papers.shared.studies.parameters import changed
from mlsroad_pipeline.papers.shared.studies.study import paper_table

ALL = (*CLASSES, "other")
N = len(ALL)


def matrix(right, *, total=100, wrong="other"):
    """Return a confusion matrix with `right` correct points per class; the others have the label `wrong`."""
    counts = np.zeros((N, N + 1), np.int64)
    for label, hits in enumerate(right):
        counts[label, label] += hits
        counts[label, ALL.index(wrong)] += total - hits
    return counts


def value_of(found, method, name, metric, repetition="a"):
    rows = found[(found["method"] == method) & (found["class"] == name) & (found["metric"] == metric)]
    return rows[rows["repetition"] == repetition]["value"].item()


def test_scores_per_class_are_those_of_the_definitions():
    counts = matrix([90, 80, 70, 60, 50, 40, 30, 100])
    counts[ALL.index("other"), ALL.index("cycas")] = 20  # 20 points more of `other`, called cycas
    found = repetition_scores({"a": {"m": counts}}, classes=ALL)
    assert value_of(found, "m", "cycas", "recall") == 0.6
    assert value_of(found, "m", "cycas", "precision") == 60 / 80
    assert value_of(found, "m", "cycas", "f1") == pytest.approx(2 * 60 / (100 + 80))
    recalls = np.arange(0.9, 0.25, -0.1)
    assert value_of(found, "m", "mean of seven", "recall") == pytest.approx(recalls.mean())
    assert value_of(found, "m", "mean of five", "recall") == pytest.approx(recalls[2:].mean())
    assert "other" not in set(found["class"])


def test_what_a_method_cannot_give_is_undefined_and_never_nought():
    counts = matrix([0, 0, 70, 60, 50, 40, 30, 100])
    found = repetition_scores({"a": {"m": counts}}, classes=ALL, given={"m": OBJECTS})
    for name in ("road", "grass", "mean of seven"):
        assert all(np.isnan(value_of(found, "m", name, metric)) for metric in ("precision", "recall", "f1"))
    assert value_of(found, "m", "mean of five", "recall") == pytest.approx(0.5)


def test_a_class_without_points_is_in_no_mean():
    counts = matrix([90, 80, 70, 60, 50, 40, 30, 100])
    counts[ALL.index("vehicle")] = 0
    counts[0, ALL.index("vehicle")] = 5  # a false vehicle makes no F1 of 0 for a class that is not there
    found = repetition_scores({"a": {"m": counts}}, classes=ALL)
    assert np.isnan(value_of(found, "m", "vehicle", "f1"))
    assert value_of(found, "m", "mean of seven", "recall") == pytest.approx(
        np.mean([90 / 105, 0.8, 0.7, 0.6, 0.5, 0.4])
    )


def test_a_scheme_without_the_classes_of_the_paper_is_refused():
    with pytest.raises(DataError, match="lacks the classes cycas"):
        repetition_scores({}, classes=[name for name in ALL if name != "cycas"])


@pytest.fixture
def three():
    """Three repetitions of two methods, one 0.1, 0.2 and 0.0 above the other."""
    low, high = (50, 60, 55), (60, 80, 55)
    return {
        name: {"patch_graph": matrix([a] * 7 + [100]), "patch_graph_mrf": matrix([b] * 7 + [100])}
        for name, a, b in zip("abc", low, high, strict=True)
    }


def test_table_three_has_mean_and_spread_over_repetitions(three):
    table = table_three(repetition_scores(three, classes=ALL))
    row = table.set_index(["method", "class", "metric"]).loc[("patch_graph", "palm tree", "recall")]
    assert row["mean"] == pytest.approx(0.55) and row["spread"] == pytest.approx(np.std([0.5, 0.6, 0.55], ddof=1))
    assert row["repetitions"] == 3 and row["paper"] == 0.856
    one = table_three(repetition_scores({"a": three["a"]}, classes=ALL))
    assert one["spread"].isna().all() and one["repetitions"].max() == 1


def test_intervals_are_those_of_the_paired_t_test(three):
    found = repetition_scores(three, classes=ALL)
    table = paired_differences(found)
    assert list(table["method"]) == ["patch_graph", "patch_graph"] and list(table["mean_over"]) == list(MEANS)
    chosen = found[(found["class"] == "mean of seven") & (found["metric"] == "f1")]
    wide = chosen.pivot(index="repetition", columns="method", values="value")
    expected = stats.ttest_rel(wide["patch_graph"], wide["patch_graph_mrf"]).confidence_interval(0.95)
    assert table.loc[0, ["low", "high"]].tolist() == pytest.approx(list(expected))
    assert table.loc[0, "difference"] == pytest.approx((wide["patch_graph"] - wide["patch_graph_mrf"]).mean())
    one = paired_differences(repetition_scores({"a": three["a"]}, classes=ALL))
    assert one[["low", "high"]].isna().all(axis=None) and one["difference"].notna().all()
    with pytest.raises(DataError, match="nobody was not scored"):
        paired_differences(found, reference="nobody")


def test_every_two_methods_are_compared_and_sure_orders_are_named(three):
    better = {name: {**methods, "shape_based": matrix([0, 0] + [90 + k] * 5 + [100])}
              for k, (name, methods) in enumerate(three.items())}  # fmt: skip
    found = repetition_scores(better, classes=ALL, given={"shape_based": OBJECTS})
    pairs = all_pairs(found).set_index(["method", "other"])
    assert list(pairs.index) == [
        ("patch_graph", "patch_graph_mrf"), ("patch_graph", "shape_based"), ("patch_graph_mrf", "shape_based"),
    ]  # fmt: skip
    assert pairs["mean_over"].tolist() == ["mean of seven", "mean of five", "mean of five"]
    known = paired_differences(found).set_index(["method", "mean_over"])["difference"]
    assert pairs.iloc[0]["difference"] == pytest.approx(known["patch_graph", "mean of seven"])
    assert pairs["sure"].tolist() == [False, True, False]
    mean = found[(found["class"] == "mean of five") & (found["metric"] == "f1")]
    wide = mean.pivot(index="repetition", columns="method", values="value")
    alone = sorted(stats.ttest_rel(wide[a], wide[b]).pvalue for a, b in list(pairs.index)[1:])
    assert sorted(pairs["p"])[0] == pytest.approx(3 * alone[0]) and pairs["p"].le(1).all()
    assert pairs.loc[("patch_graph", "shape_based"), "high"] < 0


def test_table_one_sums_the_streets_beside_the_paper():
    street = {name: np.arange(N) * factor for name, factor in (("points", 100), ("objects", 2), ("touching", 1))}
    table = table_one([street, street], ALL).set_index("class")
    assert table.loc["cycas", ["points", "objects", "touching"]].tolist() == [600, 12, 6]
    assert table["share"].sum() == pytest.approx(1) and table["paper_share"].sum() == pytest.approx(1)
    assert table.loc["palm tree", ["paper_objects", "paper_overlapping"]].tolist() == [278, 240]


def test_objects_of_a_street_are_counted_and_touching_ones():
    x = np.repeat(np.arange(4), 200)  # four patches in a row; the objects 1 and 2 lie side by side, 3 is apart
    cloud = PointCloud(
        np.column_stack([x, np.zeros(800), np.zeros(800)]),
        {"label": np.full(800, TAXONOMY["car"], np.uint8), "instance": np.repeat([1, 2, 0, 3], 200)},
    )
    patches = {"patch_of_point": x.astype(np.int32), "edges": np.array([[0, 1], [1, 2], [2, 3]]), "height": np.zeros(4)}
    found = count_street(cloud, patches, SCHEME)
    vehicle = SCHEME.classes.index("vehicle")
    assert [found[name][vehicle] for name in ("points", "objects", "touching")] == [800, 3, 2]
    assert sum(found["objects"]) == 3


def test_a_mean_that_a_method_lacks_is_in_no_comparison(three):
    given = {"patch_graph": OBJECTS}
    table = paired_differences(repetition_scores(three, classes=ALL, given=given))
    assert list(table["mean_over"]) == ["mean of five"]


PRINTED = {  # the column "average" of Table III; its precision is recall and the other way round
    "patch_svm": (0.719, 0.623, 0.646),
    "patch_forest": (0.767, 0.629, 0.66),
    "shape_based": (0.596, 0.663, 0.607),
    "max_margin_markov": (0.759, 0.827, 0.784),
    "patch_graph": (0.746, 0.813, 0.769),
    "patch_graph_mrf": (0.84, 0.896, 0.862),
}


@pytest.mark.parametrize("method", PRINTED)
def test_transcribed_figures_have_the_averages_that_the_paper_prints(method):
    table = paper_table("luo2016", "table_3")
    wide = table[table["method"] == method].drop(columns="method").set_index("metric").T.dropna()
    for metric, printed in zip(("recall", "precision", "f1"), PRINTED[method], strict=True):
        assert wide[metric].mean() == pytest.approx(printed, abs=0.0015)
    harmonic = 2 * wide["precision"] * wide["recall"] / (wide["precision"] + wide["recall"])
    assert np.abs(harmonic - wide["f1"]).max() < 0.0025


def test_sensitivity_has_one_row_per_value_in_order(three):
    facts = pd.DataFrame({"train_seconds": [1.0, 3.0], "objective": [10.0, 20.0]})
    runs = {
        value: {r: {"m": three[r]["patch_graph"]} for r in names} for value, names in {0.3: "ab", 0.1: "bc"}.items()
    }
    table = sensitivity_table(runs, {0.3: facts, 0.1: facts}, classes=ALL)
    assert table["value"].tolist() == [0.1, 0.3] and table["train_seconds"].tolist() == [2.0, 2.0]
    alone = repetition_scores({r: {"m": three[r]["patch_graph"]} for r in "ab"}, classes=ALL)
    road = alone[(alone["class"] == "road") & (alone["metric"] == "f1")]["value"].mean()
    assert table["road"][1] == pytest.approx(road)
    each = alone[(alone["class"] == "road") & (alone["metric"] == "f1")]["value"]
    assert table["road spread"][1] == pytest.approx(np.std(each, ddof=1))
    steps = by_step(table, "patch_size")
    assert steps["millimetres"].tolist() == [100, 300]
    assert steps["patch_size_mean_of_seven"].tolist() == table["mean of seven"].tolist()


def test_times_are_means_over_repetitions():
    facts = pd.DataFrame(
        {"method": ["x", "y", "x"], "train_seconds": [1.0, 5.0, 2.0], "label_seconds": [3.0, 1.0, 5.0]}
    )
    table = times_table(facts).set_index("method")
    assert table.loc["x"].tolist() == [1.5, 4.0, 2.0] and table.loc["y"].tolist() == [5.0, 1.0, 1.0]


def test_scores_frame_keeps_the_contract(three):
    table = scores_frame(repetition_scores(three, classes=ALL), three, ALL)
    row = table[(table["method"] == "patch_graph") & (table["split"] == "b") & (table["metric"] == "mean_f1")]
    assert row["class"].item() == "all" and row["support"].item() == 700
    assert len(table) == 3 * 2 * (7 * 3 + 1)


def test_table_for_people_shows_the_paper_beside_and_dashes(three):
    found = repetition_scores(three, classes=ALL, given={"patch_graph": OBJECTS})
    wide = wide_table(table_three(found), "f1").set_index("method")
    assert list(wide.columns) == [*CLASSES, *MEANS]
    assert wide.loc["patch_graph", "road"] == "– (0.980)"
    assert wide.loc["patch_graph_mrf", "mean of seven"].endswith("(0.862)")


SCALE = {
    "survey": {"preset": "tiny"}, "test_survey": {"length": 30.0}, "tuning": {}, "repetitions": [{"test": [3], "train": [1, 2]}], "patch_sizes": [0.2],
    "search_radii": [1.0], "sensitivity": 1, "radius_patches": 100, "patches": {}, "methods": {},
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"repetitions": [{"test": [1], "train": [1, 2]}]},
            r"must be distinct and not in training, got \[1\], in training \[1\]",
        ),
        (
            {"repetitions": [{"test": [3], "train": [1]}] * 2},
            r"must be distinct and not in training, got \[3, 3\], in training \[\]",
        ),
        ({"repetitions": [{"test": [1], "train": []}]}, "each must name its streets"),
        ({"sensitivity": -1}, "sensitivity must be at least 0, got -1"),
        ({"radius_patches": 0}, "radius_patches must be at least 1, got 0"),
        ({"patch_sizes": [0.0]}, "patch_sizes must be a finite number > 0, got 0"),
        ({"survey": {"seed": 1}}, "must not have a seed; seeds belong in repetitions"),
        ({"test_survey": {"seed": 1}}, "must not have a seed; seeds belong in repetitions"),
        ({"tuning": {"patch_graph_mrf": []}}, "'patch_graph_mrf'.* are not trained"),
    ],
)
def test_wrong_scales_are_named(change, message):
    with pytest.raises(ParameterError, match=message):
        StudyScale(**{**SCALE, **change})


def test_wrong_studies_are_named():
    given = {"scale": "s", "scales": {"s": SCALE}, "scheme": "luo2016"}
    assert StudyParameters(**given).chosen_scale() == StudyScale(**SCALE)
    with pytest.raises(ParameterError, match="scale 'x' is unknown"):
        StudyParameters(**{**given, "scale": "x"})
    with pytest.raises(ParameterError, match="scales.s must have"):
        StudyParameters(**{**given, "scales": {"s": {}}})


def test_parameters_are_changed_field_by_field():
    found = changed(PatchGraphParameters(), {"search": {"search_radius": 0.3}, "n_matches": 5})
    assert (found.search.search_radius, found.n_matches) == (0.3, 5)
    assert found.search.propagation_radius == PatchGraphParameters().search.propagation_radius
    with pytest.raises(ParameterError, match="PatchParameters has no patch_sise"):
        changed(PatchParameters(), {"patch_sise": 1.0})
