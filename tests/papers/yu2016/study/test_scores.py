"""Tables of the study of yu2016: counts by hand, consistency of the printed tables, intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.papers.shared.studies.study import paper_table
from mlsroad_pipeline.papers.yu2016.study import scores as yu2016
from mlsroad_pipeline.papers.yu2016.study.parameters import StudyParameters, StudyScale, StudySurvey, model_key, run_key
from mlsroad_pipeline.papers.yu2016.study.runs import (
    joint_prevalence,
    make_survey,
    separate_images,
    touching_instances,
    whole_gantries,
    without_streaks,
)
from mlsroad_pipeline.papers.yu2016.study.study import found_by_detector
from mlsroad_pipeline.simulation.parameters.presets import PRESETS


def street(objects, label, right, score):
    """Return the counts of a street; every object with a score is detected."""
    found = {"label": np.array(label, np.int16), "right": np.array(right, bool), "score": np.array(score, np.float32)}
    return {"n_objects": np.array(objects), **found, **{f"curve_{name}": values for name, values in found.items()}}


ONE = street([2, 1], [0, 0, 1], [True, False, True], [0.9, 0.6, 0.8])
TWO = street([1, 3], [1, 1], [True, False], [0.7, 0.5])


def test_counts_of_streets_are_summed():
    table = yu2016.table_two({"RRS": {"a": ONE, "b": TWO}}, ["light pole", "car"]).set_index("class")
    assert table.loc["light pole", ["objects", "found", "false"]].tolist() == [3, 1, 1]
    assert table.loc["car", ["objects", "found", "false"]].tolist() == [4, 2, 1]
    assert table.loc["all", ["objects", "found", "false"]].tolist() == [7, 3, 2]
    assert table.loc["all", "paper_found"] == 628 + 235 + 143


def test_figures_are_over_all_streets_and_their_spread_over_each():
    found = yu2016.figures_by_survey({"visual_words": {"RRS": {"a": ONE, "b": TWO}}}, [0, 1])
    recall = found[(found["metric"] == "recall") & (found["survey"] == "RRS")]
    assert recall["value"].item() == pytest.approx(3 / 7)
    assert recall["spread"].item() == pytest.approx(np.std([2 / 3, 1 / 4], ddof=1))
    average = found[(found["metric"] == "f_score") & (found["survey"] == "average")]
    assert average["value"].item() == pytest.approx(2 * 3 / (2 * 3 + 2 + 4))


def test_differences_are_paired_by_street():
    streets = {"a": {"RRS": {"a": ONE, "b": TWO}}, "visual_words": {"RRS": {"a": TWO, "b": TWO}}}
    row = yu2016.paired_differences(streets, [0, 1], reference="visual_words").iloc[0]
    apart = np.array([4 / 6 - 2 / 6, 0.0])
    assert row["difference"] == pytest.approx(apart.mean())
    half = stats.t.ppf(0.975, 1) * apart.std(ddof=1) / np.sqrt(2)
    assert (row["low"], row["high"]) == pytest.approx((apart.mean() - half, apart.mean() + half))


def test_pooled_curve_measures_scores_by_their_threshold():
    level, precision, recall = yu2016.pooled_curve({"a": ONE}, np.array([0.9, 0.4]))
    np.testing.assert_allclose(level, [2.0, 1.0, 2 / 3], rtol=1e-6)
    np.testing.assert_allclose(precision, [1.0, 1.0, 2 / 3])
    np.testing.assert_allclose(recall, [1 / 3, 2 / 3, 2 / 3])


def test_the_papers_tables_agree_with_each_other():
    """Table III follows from Table II, and the F-scores of Table V from its counts."""
    two = paper_table("yu2016", "table_2").set_index(["survey", "class"])
    three = paper_table("yu2016", "table_3").set_index(["survey", "metric"])["paper"]
    for survey in ("RRS", "SPP"):
        objects, found, false = two.loc[(survey, "all"), ["paper_objects", "paper_found", "paper_false"]]
        assert found / objects == pytest.approx(three[survey, "recall"], abs=6e-4)
        assert found / (found + false) == pytest.approx(three[survey, "precision"], abs=6e-4)
        assert 2 * found / (objects + found + false) == pytest.approx(three[survey, "f_score"], abs=6e-4)
    five = yu2016.paper_cars()  # 0.923 is printed as 0.922
    assert five["paper_f_score"].round(3).tolist() == [0.899, 0.916, 0.911, 0.923, 0.938, 0.949, 0.944, 0.954]


def test_touching_instances_share_a_cluster(rng):
    def box(x):
        return rng.uniform([x, 0, 0], [x + 0.5, 0.5, 0.5], (400, 3))

    xyz = np.concatenate([box(0), box(0.55), box(3)])
    points = PointCloud(xyz, {"instance": np.repeat([5, 6, 7], 400), "ground": np.zeros(1200, bool)})
    assert touching_instances(points, points["instance"], np.array([5, 6, 7]), 30).tolist() == [True, True, False]


def test_streets_may_not_be_learned_from_and_scored_on():
    with pytest.raises(ParameterError, match="must be non-empty and distinct"):
        StudySurvey({}, [1, 2], [2])
    with pytest.raises(ParameterError, match="scale 'huge' is unknown"):
        StudyParameters("huge", {"fast": {}})


def test_streets_with_more_of_what_is_rare_are_training_streets_that_differ_further():
    survey = StudySurvey(
        {"length": 50.0, "street": {"signs": 1.0, "traffic": 0.2}}, [1, 2], [3],
        train_survey={"street": {"traffic": 0.8}}, rare=[2], rare_survey={"speed": 4.0, "street": {"traffic": 2.0}},
    )  # fmt: skip
    assert survey.street(1) == {"length": 50.0, "street": {"signs": 1.0, "traffic": 0.8}, "seed": 1}
    assert survey.street(2) == {"length": 50.0, "speed": 4.0, "street": {"signs": 1.0, "traffic": 2.0}, "seed": 2}
    assert survey.street(3) == {"length": 50.0, "street": {"signs": 1.0, "traffic": 0.2}, "seed": 3}
    with pytest.raises(ParameterError, match=r"streets \[3\] of `rare` are not in train"):
        replace(survey, rare=[3])
    with pytest.raises(ParameterError, match="rare_weight must be at least 0"):
        replace(survey, rare_weight=-1)
    with pytest.raises(ParameterError, match="all training streets are `rare`"):
        replace(survey, rare=[2, 1])
    with pytest.raises(ParameterError, match="must not have a seed; seeds belong in train and test"):
        replace(survey, rare_survey={"seed": 4})


def test_models_of_one_detector_are_joined_by_street():
    surveys = {name: StudySurvey({}, [1], [2]) for name in ("RRS", "SPP")}
    scale = StudyScale(surveys, ["single"], [0.1], [0])
    assert scale.learned_together() == [["RRS", "SPP"]]
    assert replace(scale, pooled=False).learned_together() == [["RRS"], ["SPP"]]
    models = {
        model_key("a", ["RRS"]): {"RRS_2": ONE, "facts": {}},
        model_key("a", ["SPP"]): {"SPP_2": TWO, "facts": {}},
        model_key("b", ["RRS", "SPP"]): {"RRS_2": TWO},
    }
    assert list(models) == ["a.RRS", "a.SPP", "b.RRS_SPP"]
    assert found_by_detector(models) == {"a": {"RRS_2": ONE, "SPP_2": TWO}, "b": {"RRS_2": TWO}}


def test_prevalence_of_surveys_is_joined_by_their_training_objects():
    labels = {
        run_key("A", 1): {"label": np.array([0, 0, 1, -1]), "own": np.array([True, True, True, True])},
        run_key("A", 2): {"label": np.array([0, 2]), "own": np.array([True, False])},
        run_key("B", 1): {"label": np.array([0, 1, 1, 1]), "own": np.ones(4, bool)},
    }
    found = joint_prevalence(labels, {"A": {"pole": 0.5}, "B": {"pole": 2.0, "sign": 0.1}}, ["pole", "sign", "car"])
    assert found == pytest.approx({"pole": (3 * 0.5 + 2.0) / 4, "sign": (1 + 3 * 0.1) / 4})  # no car was learned from


def test_each_image_of_what_moved_is_an_object(rng):
    """A car recorded by both scanners 20 m apart, a parked car seen from two sides, a hedge in two pieces."""
    box = rng.uniform([0, 0, 0], [4, 2, 1.5], (600, 3))
    sides = np.concatenate([rng.uniform([0, y, 0], [4, y + 0.1, 1.5], (300, 3)) for y in (0.0, 1.8)])
    parts = [box, box + [20, 3, 0], sides + [0, 30, 0], box + [0, 60, 0], box + [30, 60, 0], box + [90, 0, 0]]
    xyz = np.concatenate(parts)
    instance = np.repeat([5, 5, 7, 9, 9, 0], 600)
    vehicle = np.repeat([True, True, True, False, False, True], 600)
    order = rng.permutation(len(xyz))
    found = np.empty(len(xyz), np.int64)
    found[order] = separate_images(xyz[order], instance[order], vehicle[order])
    first = [np.unique(found[instance_rows]) for instance_rows in np.arange(3600).reshape(6, 600)]
    assert all(len(one) == 1 for one in first)
    names = [int(one[0]) for one in first]
    assert names[2:] == [7, 9, 9, 0]
    assert sorted(names[:2]) == [5, 10]  # one image keeps the number, the other gets the next that is free
    np.testing.assert_array_equal(separate_images(xyz, np.zeros(3600, int), vehicle), 0)


def test_a_car_drawn_over_many_metres_is_no_reference_object(rng):
    """Its axis is oblique, so that its extents along x and y are below the bound; a bus of the same length remains."""
    car = rng.uniform([-2.2, -0.9, 0], [2.2, 0.9, 1.5], (500, 3))
    turn = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2)]]) / np.sqrt(2)
    streak = (car * [2.0, 1.0, 1.0]) @ turn
    assert np.ptp(streak, axis=0).max() < 8
    xyz = np.concatenate([car, streak + 30, car * [2.6, 1.2, 2.0] + 60, car[:1] + 90])
    instance = np.repeat([3, 4, 8, 9, 0], [500, 500, 300, 200, 1])
    kept = without_streaks(xyz, instance, np.repeat([True, False, True], [1000, 500, 1]))
    np.testing.assert_array_equal(kept, np.where(instance == 4, 0, instance))
    np.testing.assert_array_equal(without_streaks(xyz, instance, np.zeros(1501, bool)), instance)


def test_a_second_pass_doubles_the_points_and_leaves_the_ends_where_they_are():
    """Stations are those of the first pass, so that points of both passes lie within the street."""
    clouds = []
    for passes in (1, 2):
        tiny = replace(PRESETS["tiny"], length=20.0, passes=passes, with_images=False, seed=3)
        clouds.append(make_survey(simulation=tiny, ground=GroundParameters())["points"])
    one, two = clouds
    assert two["core"].mean() == pytest.approx(one["core"].mean(), abs=0.02)
    for cloud in clouds:
        extent = np.ptp(cloud.xyz[cloud["core"]], axis=0)
        np.testing.assert_allclose(extent, np.ptp(one.xyz[one["core"]], axis=0), atol=2.0)
    assert two["core"].sum() > 1.7 * one["core"].sum()


def test_boards_of_a_gantry_are_no_signs():
    """Another sign, and points of a gantry without an instance, keep their class."""
    gantry, sign, tree = (TAXONOMY[name] for name in ("gantry", "traffic_sign", "tree"))
    label = np.array([gantry, sign, sign, sign, tree, gantry])
    found = whole_gantries(label, np.array([4, 4, 4, 5, 0, 0]))
    assert found.tolist() == [gantry, gantry, gantry, sign, tree, gantry]
