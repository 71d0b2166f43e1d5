"""Given classes in a scene: kept labels, ground and noise, contradictions, clashes of codes."""

import numpy as np
import pytest
from helpers.labelled import scheme as configured_scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.given_labels.labeller import SLUG, given_bundle
from mlsroad_pipeline.label.given_classes import (
    GivenClasses,
    given_classes,
    given_warnings,
    ground_of_scene,
    with_given,
)
from mlsroad_pipeline.label.scene import LabelSettings, label_new_scene, object_rules
from mlsroad_pipeline.surveys.class_map_files import read_class_map
from mlsroad_pipeline.surveys.given_classes import GivenParameters
from mlsroad_pipeline.surveys.plan import SurveyPlan

SCHEME = ClassScheme.from_config("road_inventory", configured_scheme())
GIVEN = GivenClasses(read_class_map("asprs", SCHEME))
PAVED, NATURAL, POLE = (SCHEME.classes.index(name) for name in ("paved ground", "natural ground", "pole"))


@pytest.fixture
def scene(rng):
    """A street with a post; a platform of class 2 above it; noise on the post."""
    flat = np.column_stack([rng.random((20_000, 2)) * 12, rng.random(20_000) * 0.02])
    turn, z = rng.random(3000) * 2 * np.pi, rng.random(3000) * 4
    post = np.column_stack([3 + 0.05 * np.cos(turn), 4 + 0.05 * np.sin(turn), z])
    high = np.column_stack([8 + rng.random((200, 2)), 5 + rng.random(200) * 0.02])
    xyz = np.concatenate([flat, post, high]).astype(np.float32)
    codes = np.repeat([2, 64, 2], [20_000, 3000, 200])
    codes[20_000:20_100] = 7
    codes[20_100:20_200] = 9
    codes[:50] = 1
    columns = {"core": np.ones(len(xyz), np.bool_), "file": np.zeros(len(xyz), np.int16)}
    return PointCloud(xyz, {**columns, "row": np.arange(len(xyz)), "kept": codes.astype(np.int32)})


def labelled(scene, **changes):
    bundle = given_bundle(SCHEME)
    settings = LabelSettings(SCHEME.codes(), object_rules(bundle, {}), given=changes.get("given", GIVEN))
    return label_new_scene(scene, bundle, settings, name="s")


def test_kept_classes_list_the_objects_and_are_written_back(scene):
    found = labelled(scene)
    codes, labels = scene["kept"], found["labels"]
    assert np.array_equal(labels["kept"], np.where(codes == 1, 0, codes))
    assert (labels["label"][codes == 64] == POLE).all() and (labels["label"][codes == 2] == PAVED).all()
    assert (labels["label"][codes == 7] == len(SCHEME) + 1).all() and (labels["label"][codes == 9] == len(SCHEME)).all()
    assert (labels["confidence"][codes != 1] == 1).all() and (labels["confidence"][codes == 1] == 0).all()
    (pole,) = found["objects"].to_dict("records")
    assert pole["class"] == "pole" and pole["z"] == pytest.approx(0.01, abs=0.02)
    assert (labels["part"][codes == 7] == 0).all() and (labels["part"][codes == 64] == 1).mean() > 0.99
    assert found["counts"]["given"].tolist() == [(codes != 1).sum(), 200, 0]


def test_lifted_ground_is_counted_and_no_ground_of_heights(scene):
    resolved = with_given(scene, GIVEN, SCHEME)
    ground = ground_of_scene(resolved, GroundParameters())
    assert ground["ground"].sum() == 19_950 and not ground["ground"][-200:].any()
    assert ground["height"][-200:] == pytest.approx(5, abs=0.05)
    warning = "200 points of given ground lie more than 2 m above the ground around them"
    assert given_warnings(np.array([9, 200, 0]))[0].startswith(warning)
    assert "No point has a class to keep" in given_warnings(np.zeros(3, np.int64))[0] and given_warnings(None) == []


def test_ground_of_the_filter_fills_what_the_given_ground_does_not_cover(scene):
    codes = np.where(scene.xyz[:, 0] > 3, 1, scene["kept"])
    resolved = with_given(scene.with_columns(kept=codes), GIVEN, SCHEME)
    ground = ground_of_scene(resolved, GroundParameters())["ground"]
    assert not ground[:20_000][(scene.xyz[:20_000, 0] > 4) & (scene.xyz[:20_000, 0] < 7)].any()
    assert ground[:20_000][scene.xyz[:20_000, 0] > 10].mean() > 0.9
    none = with_given(scene.with_columns(kept=np.full(len(scene), -1)), GIVEN, SCHEME)
    assert ground_of_scene(none, GroundParameters())["ground"][:20_000].mean() > 0.9


def test_a_method_chooses_among_ground_classes_and_labels_the_rest(scene):
    def natural(cloud, bundle):
        return np.full(len(cloud), NATURAL), np.full(len(cloud), 0.5)

    bundle = ModelBundle(SLUG, {}, given_bundle(SCHEME).metadata)
    settings = LabelSettings(SCHEME.codes(), object_rules(bundle, {}), given=GIVEN)
    codes = scene["kept"]
    found = label_new_scene(scene, bundle, settings, name="s", labeller=natural)["labels"]
    assert (found["label"][(codes == 1) | (codes == 2)] == NATURAL).all()
    assert (found["label"][codes == 64] == POLE).all()
    road = scene.with_columns(kept=np.where(codes == 2, 11, codes))
    assert (
        label_new_scene(road, bundle, settings, name="s", labeller=natural)["labels"]["label"][codes == 2] == PAVED
    ).all()


def test_a_number_with_another_meaning_in_the_results_is_an_error(scene, tmp_path):
    (tmp_path / "own.yml").write_text("2: other_ground\n64: tree\n1: unlabelled\n7: outlier\n9:\n")
    own = GivenClasses(read_class_map(str(tmp_path / "own.yml"), SCHEME))
    clashing = own.with_clashes(SCHEME.codes(), SCHEME)
    with pytest.raises(DataError, match=r"class number 64 is tree in class map .*own\.yml and pole in the results"):
        labelled(scene, given=clashing)
    assert not GIVEN.with_clashes(SCHEME.codes(), SCHEME).clashes
    assert own.code_names({64: "pole", 2: "natural ground"})[9] == "9"


def test_predictions_and_a_model_need_a_weight():
    plan = SurveyPlan((), None, labels=False, given=GivenParameters(labels="x", labels_classes="asprs"))
    model = ModelBundle("boosted_trees", {}, given_bundle(SCHEME).metadata)
    with pytest.raises(ParameterError, match=r"take the place of the model boosted_trees: set label\.given\.weight"):
        given_classes(plan, model, SCHEME.codes(), {})
