"""Labelling of a scene by a model of any method, which needs classes and a scheme alone."""

import sys
import types
from dataclasses import asdict, replace

import numpy as np
import pytest
from helpers.planted_method import plant_method

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.lines.barriers import join_barriers
from mlsroad_pipeline.algorithms.inventory.lines.markings.marking_lines import join_markings
from mlsroad_pipeline.algorithms.inventory.objects.sightings import visit_columns
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.label.result_warnings import below_warnings
from mlsroad_pipeline.label.scene import LabelSettings, label_new_scene, object_rules
from mlsroad_pipeline.label.written_file import output_codes, point_codes

MODULE = "mlsroad_pipeline.algorithms.planted_for_labelling"
SCHEME = ClassScheme.from_config(
    "planted",
    {
        "classes": {
            "ground": {"members": ["road"], "asprs": 11},
            "pole": {"members": ["light_pole"], "asprs": 64},
        },
        "ignore": ["unlabelled"],
    },
)


def label_by_height(cloud, bundle):
    above = cloud.xyz[:, 2] > bundle.arrays["height"][0]
    label = np.where(above, 1, 0)
    label[cloud.xyz[:, 0] > 7] = -1
    return label, np.where(above, 0.4, 0.9)


def planted(monkeypatch, **metadata):
    module = types.ModuleType(MODULE)
    module.label_by_height = label_by_height
    monkeypatch.setitem(sys.modules, MODULE, module)
    plant_method(monkeypatch, "planted", f"{MODULE}:label_by_height")
    given = {"classes": list(SCHEME.classes), **metadata}
    return ModelBundle("planted", {"height": np.array([0.3])}, given)


def test_a_model_of_any_method_labels_a_scene_and_fills_the_inventory(monkeypatch, rng):
    bundle = planted(monkeypatch, scheme=asdict(SCHEME))
    flat = np.column_stack([rng.random((20_000, 2)) * 8, rng.random(20_000) * 0.02])
    turn, z = rng.random(3000) * 2 * np.pi, rng.random(3000) * 4
    post = np.column_stack([3 + 0.05 * np.cos(turn), 4 + 0.05 * np.sin(turn), z])
    xyz = np.concatenate([flat, post]).astype(np.float32)
    core = xyz[:, 0] < 7.5
    columns = {"core": core, "file": np.zeros(len(xyz), np.int16), "row": np.arange(len(xyz), dtype=np.int64)}
    codes = output_codes(bundle, "asprs", {})
    found = label_new_scene(
        PointCloud(xyz, columns),
        bundle,
        LabelSettings(codes, object_rules(bundle, {})),
        name="s",
    )
    expected = np.where(xyz[:, 2] > np.float32(0.3), 64, 11)
    expected[xyz[:, 0] > 7] = 1
    assert np.array_equal(point_codes(codes)[found["labels"]["label"]], expected[core])
    assert np.array_equal(found["labels"]["part"], (expected[core] == 64).astype(int))
    assert np.array_equal(found["labels"]["row"], np.flatnonzero(core))
    n_none, n_pole = (expected[core] == 1).sum(), (expected[core] == 64).sum()
    assert found["counts"]["counts"].tolist() == [core.sum() - n_none - n_pole, n_pole, n_none]
    assert found["counts"]["confidences"].sum(axis=1).tolist() == [core.sum() - n_none - n_pole, n_pole]
    assert found["counts"]["confidences"][1].argmax() == 40
    (pole,) = found["objects"].to_dict("records")
    assert pole["class"] == "pole" and pole["x"] == pytest.approx(3, abs=0.05) and pole["height"] > 3.5


@pytest.mark.parametrize("top", [-3.2, -1.1, -0.6, 4.0])
def test_objects_below_the_ground_are_not_listed(monkeypatch, rng, top):
    bundle = planted(monkeypatch, scheme=asdict(SCHEME))
    flat = np.column_stack([rng.random((20_000, 2)) * 8, rng.random(20_000) * 0.02])
    turn, z = rng.random(3000) * 2 * np.pi, -5.0 + rng.random(3000) * (5.0 + top)
    post = np.column_stack([3 + 0.05 * np.cos(turn), 4 + 0.05 * np.sin(turn), z])
    xyz = np.concatenate([flat, post]).astype(np.float32)
    of_post, n = np.arange(len(xyz)) >= len(flat), len(xyz)
    columns = {"core": np.ones(n, bool), "file": np.zeros(n, np.int16), "row": np.arange(n, dtype=np.int64)}
    monkeypatch.setattr(
        sys.modules[MODULE], "label_by_height", lambda cloud, bundle: (of_post.astype(int), np.full(n, 0.9))
    )
    ground = {"ground": ~of_post, "height": xyz[:, 2]}
    monkeypatch.setattr("mlsroad_pipeline.label.scene.ground_of_scene", lambda scene, parameters: ground)
    settings = LabelSettings(output_codes(bundle, "asprs", {}), object_rules(bundle, {}))
    found = label_new_scene(PointCloud(xyz, columns), bundle, settings, name="s")
    below = of_post & (xyz[:, 2] < -0.5)
    assert found["counts"]["below"] == below.sum()
    assert (
        f"{below.sum():,} points of classes of objects lie more than 0.5 m below"
        in below_warnings({"s": found["counts"]})[0]
    )
    if top < 0:
        assert not len(found["objects"])
        return
    (pole,) = found["objects"].to_dict("records")
    assert pole["point_count"] == (of_post & ~below).sum() and pole["clearance"] > -0.51
    assert not found["labels"]["part"][below].any()


def test_context_serves_the_labels_alone(monkeypatch, rng):
    seen = []

    def count(cloud, bundle):
        seen.append(len(cloud))
        return label_by_height(cloud, bundle)

    bundle = planted(monkeypatch, scheme=asdict(SCHEME))
    monkeypatch.setattr(sys.modules[MODULE], "label_by_height", count)
    xyz = np.concatenate([rng.random((4000, 3)) * [8, 8, 0.02], [2, 2, 0] + rng.random((500, 3)) * [0.1, 0.1, 4]])
    core, near = xyz[:, 0] < 4, xyz[:, 0] < 6
    columns = {"core": core, "file": np.zeros(len(xyz), np.int16), "row": np.arange(len(xyz), dtype=np.int64)}
    settings = LabelSettings(output_codes(bundle, "asprs", {}), object_rules(bundle, {}))
    scene = PointCloud(xyz.astype(np.float32), columns)
    wide = label_new_scene(scene.with_columns(near=near), bundle, settings, name="s")
    alone = label_new_scene(scene.select(near), bundle, settings, name="s")
    assert seen == [len(xyz), near.sum()] and len(wide["objects"]) == 1
    for name, values in alone["labels"].items():
        assert np.array_equal(wide["labels"][name], values), name
    assert wide["objects"][["x", "y"]].to_numpy() == pytest.approx(alone["objects"][["x", "y"]].to_numpy(), abs=0.02)


def test_two_scanner_heads_known_by_their_source_reach_the_markings(monkeypatch, rng):
    bundle = planted(monkeypatch, scheme=asdict(SCHEME))
    n = 40_000
    xyz = np.column_stack([rng.random((n, 2)) * 7, rng.random(n) * 0.02]).astype(np.float32)
    head = rng.integers(1, 3, n)
    intensity = 100 + 12 * (np.abs(xyz[:, 1] - 3.0) < 0.06) + rng.normal(0, 1, n)
    columns = {
        "core": np.ones(n, bool),
        "file": np.zeros(n, np.int16),
        "row": np.arange(n, dtype=np.int64),
        "intensity": np.where(head == 2, 0.7 * intensity, intensity).astype(np.float32),
        **visit_columns(PointCloud(xyz, {"gps_time": np.full(n, 5.0), "point_source_id": head.astype(np.uint16)})),
    }
    settings = LabelSettings(output_codes(bundle, "asprs", {}), object_rules(bundle, {}), least_contrast=2.0)
    found = label_new_scene(PointCloud(xyz, columns), bundle, settings, name="s")
    (line,) = join_markings([found["markings"]]).to_dict("records")
    assert line["kind"] == "lane_line" and line["length"] == pytest.approx(7.0, abs=0.6)
    none = label_new_scene(PointCloud(xyz, columns), bundle, replace(settings, least_contrast=None), name="s")
    assert len(none["markings"]) == 0


def test_a_model_without_a_scheme_is_named(monkeypatch):
    with pytest.raises(ParameterError, match="model 'planted' has no class scheme in its metadata"):
        output_codes(planted(monkeypatch), "asprs", {})


def test_a_fence_reaches_the_barriers_without_outliers_and_buffers(monkeypatch, rng):
    classes = {"ground": {"members": ["road"], "asprs": 11}, "fence": {"members": ["fence", "wall"], "asprs": 68}}
    scheme = ClassScheme.from_config("planted", {"classes": classes, "ignore": ["unlabelled"]})
    bundle = planted(monkeypatch, scheme=asdict(scheme), classes=list(scheme.classes))
    flat = np.column_stack([rng.random((20_000, 2)) * [7, 4], rng.random(20_000) * 0.02])
    fence = np.column_stack([rng.random(3000) * 7, 2 + rng.normal(0, 0.02, 3000), rng.random(3000) * 1.5])
    xyz = np.concatenate([flat, fence]).astype(np.float32)
    core, n = xyz[:, 0] < 5, len(xyz)
    columns = {"core": core, "file": np.zeros(n, np.int16), "row": np.arange(n, dtype=np.int64)}
    settings = LabelSettings(output_codes(bundle, "asprs", {}), object_rules(bundle, {}))
    found = label_new_scene(PointCloud(xyz, columns), bundle, settings, name="s")
    (line,) = join_barriers([found["barriers"]]).to_dict("records")
    assert line["kind"] == "barrier" and line["length"] == pytest.approx(4.6, abs=0.5)
    assert line["height"] == pytest.approx(1.4, abs=0.15)
    stray = PointCloud(xyz, {**columns, "outlier": np.arange(n) >= len(flat)})
    assert len(label_new_scene(stray, bundle, settings, name="s")["barriers"]) == 0
