"""Errors of the inventory: planted errors are recovered, those on a simulated street are small."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.measure_errors import (
    kinds_of_truth,
    match_to_truth,
    measurement_errors,
    summarise_errors,
)

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.inventory.objects.extraction import measure_points
from mlsroad_pipeline.algorithms.inventory.objects.measures import MEASURES
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS, ObjectRule
from mlsroad_pipeline.algorithms.stages import find_ground
from mlsroad_pipeline.simulation import PRESETS, simulate_survey
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS

TRUTH = {
    "x": 0.0, "y": 0.0, "z": 30.0, "moving": False, "design": "any", "length": 4.5, "width": 1.9, "height": 3.0,
    "heading": np.radians(30.0), "box_x": 0.0, "box_y": 0.0, "tilt": np.nan, "lean_azimuth": np.nan,
    "panel_bottom": np.nan, "panel_centre": np.nan, "panel_height": np.nan, "panel_width": np.nan,
    "panel_azimuth": np.nan,
}  # fmt: skip


def truth_of(*rows):
    named = [{**TRUTH, **row, "label": TAXONOMY[row["label"]]} for row in rows]
    return kinds_of_truth(pd.DataFrame(named), KIND_OF_CLASS)


def found_of(*rows):
    empty = dict.fromkeys(MEASURES, np.nan) | {"facing_from": ""}
    return pd.DataFrame([{**empty, **row} for row in rows])


def test_planted_errors():
    truth = truth_of(
        {"label": "light_pole", "tilt": 2.0, "lean_azimuth": 355.0},
        {"label": "light_pole", "tilt": 0.2, "lean_azimuth": 100.0},
        {"label": "car", "box_x": 10.0},
        {"label": "traffic_sign", "panel_bottom": 2.2, "panel_azimuth": 350.0},
        {"label": "traffic_sign", "panel_azimuth": 350.0},
        {"label": "traffic_sign", "panel_azimuth": 350.0, "design": "street_name_sign"},
        {"label": "car", "moving": True},
        {"label": "road"},
    )
    assert len(truth) == 6  # what moves and what has no kind is left out
    found = found_of(
        {"kind": "pole", "x": 0.3, "y": 0.4, "z": 30.1, "height": 2.9, "tilt": 2.5, "lean_azimuth": 10.0},
        {"kind": "pole", "x": 0.0, "y": 0.0, "z": 30.0, "height": 3.0, "tilt": 0.6, "lean_azimuth": 200.0},
        {"kind": "vehicle", "x": 10.0, "y": 0.1, "z": 30.0, "heading": 238.0, "length": 4.2, "width": 1.8},
        {"kind": "sign", "x": 0, "y": 0, "panel_bottom": 2.0, "facing": 5.0, "facing_from": "post"},
        {"kind": "sign", "x": 0, "y": 0, "facing": 172.0, "facing_from": "unknown"},
        {"kind": "sign", "x": 0, "y": 0, "facing": 171.0, "facing_from": "post"},
    )
    errors = measurement_errors(found, truth)
    np.testing.assert_allclose(errors["base"], [0.5, 0, 0.1, 0, 0, 0])
    np.testing.assert_allclose(errors["elevation"][:3], [0.1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(errors["lean_azimuth"], [15, np.nan, np.nan, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(errors["tilt"], [0.5, 0.4, np.nan, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(errors["heading"], [np.nan, np.nan, -2, np.nan, np.nan, np.nan], atol=1e-9)
    np.testing.assert_allclose(errors["length"], [np.nan, np.nan, -0.3, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(errors["facing"], [np.nan, np.nan, np.nan, 15, 2, 1], atol=1e-9)
    table = summarise_errors(errors).set_index(["class", "measure"])
    assert table.loc[("light_pole", "base"), ["n", "median", "bias"]].tolist() == [2, 0.25, 0.25]
    assert table.loc[("light_pole", "height"), "bias"] == pytest.approx(-0.05)
    assert ("light_pole", "heading") not in table.index
    with pytest.raises(DataError, match="5 measured objects cannot be compared with 6"):
        measurement_errors(found.head(5), truth)


def test_pairs_are_the_nearest_of_a_kind(rng):
    truth = pd.DataFrame({"kind": ["pole"] * 40 + ["tree"] * 40, "x": rng.uniform(0, 20, 80)})
    truth["y"], truth["box_x"], truth["box_y"] = rng.uniform(0, 5, 80), 0.0, 0.0
    objects = truth.sample(60, random_state=1)[["kind", "x", "y"]].assign(x=lambda t: t["x"] + 0.2)
    found, true = match_to_truth(objects, truth)
    free_a, free_b, expected = set(range(60)), set(range(80)), []
    a, b = objects[["x", "y"]].to_numpy(), truth[["x", "y"]].to_numpy()
    alike = objects["kind"].to_numpy()[:, None] == truth["kind"].to_numpy()
    away = np.where(alike, np.hypot(*(a[:, None] - b).transpose(2, 0, 1)), np.inf)
    for i, j in sorted(np.ndindex(60, 80), key=lambda pair: away[pair]):
        if away[i, j] <= 1 and i in free_a and j in free_b:
            free_a.remove(i)
            free_b.remove(j)
            expected.append((i, j))
    assert list(zip(found.tolist(), true.tolist(), strict=True)) == sorted(expected)
    assert len(match_to_truth(objects.head(0), truth)[0]) == 0


def test_measures_on_a_simulated_street():
    parameters = replace(PRESETS["small"], seed=23, length=60.0, with_images=False, street=STREETS["town"])
    survey = simulate_survey(parameters)
    cloud, truth = survey.cloud, kinds_of_truth(survey.objects, KIND_OF_CLASS)
    height = find_ground(cloud, GroundParameters())["height"]
    rows, kept = [], []
    for row, (instance, code, kind) in enumerate(truth[["instance", "label", "kind"]].itertuples(index=False)):
        mine = (cloud["instance"] == instance) & np.isfinite(height)
        if kind != "tree":
            mine &= cloud["label"] == code
        rule = ObjectRule.of_kind(kind, int(code))
        if mine.sum() >= max(rule.min_points, 60):
            measures = measure_points(cloud.xyz[mine], rule, height_above_ground=height[mine], origin=survey.origin)
            rows.append({**measures, "kind": kind})
            kept.append(row)
    errors = measurement_errors(pd.DataFrame(rows), truth.iloc[kept])
    kinds = [KIND_OF_CLASS[name] for name in errors["class"]]
    size = errors.drop(columns=["class", "design"]).abs()
    medians = size.groupby(kinds).median()
    assert {TAXONOMY_NAMES[code] for code in truth["label"]} >= {"car", "light_pole", "traffic_sign"}
    assert set(kinds) == {"pole", "sign", "vehicle", "tree"}
    assert (medians["base"] < 0.10).all()
    assert (medians.loc[["pole", "sign", "vehicle"], "height"] < 0.15).all()
    assert medians.loc["pole", "tilt"] < 1.0
    assert medians.loc["vehicle", "heading"] < 5.0
    assert medians.loc["sign", "facing"] < 5.0
    assert medians.loc["sign", "panel_bottom"] < 0.15
