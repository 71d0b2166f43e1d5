"""Disturbed streets on which the object classifier is trained."""

import numpy as np
import pandas as pd
import pytest
from helpers.conf import base

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, ClassScheme
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence, group_shares
from mlsroad_pipeline.algorithms.inventory.training.streets import (
    DOUBT,
    Street,
    confuse_poles,
    confuse_signs,
    disturb,
    with_gaps,
)

SCHEME = ClassScheme.from_config("road_inventory", base("classes")["schemes"]["road_inventory"])


def test_a_disturbed_street_has_probabilities_and_keeps_its_ground():
    rng = np.random.default_rng(0)
    local = rng.uniform(0, 9, (300, 3))
    height = np.where(np.arange(300) % 3 == 0, 0.0, local[:, 2])
    probabilities = rng.dirichlet(np.ones(len(SCHEME)), 100).astype(np.float32)
    owner = np.where(np.arange(300) % 50 == 7, -1, np.arange(300) % 100)
    evidence = ClassEvidence(probabilities, owner, group_shares(SCHEME))
    codes = [TAXONOMY[name] for name in ("light_pole", "car")]
    objects = pd.DataFrame({"label": codes, "instance": [3, 4], "x": 4.0, "y": 5.0})
    street = Street("s", local, np.zeros(3), height, evidence, owner, owner, objects, SCHEME)
    first, again, other = (disturb(street, seed) for seed in (1, 1, 2))
    assert first.evidence.probabilities.sum(axis=1) == pytest.approx(np.ones(100), abs=1e-5)
    assert np.array_equal(first.evidence.probabilities, again.evidence.probabilities)
    assert not np.allclose(first.evidence.probabilities, other.evidence.probabilities)
    moved = first.local - local
    still, raised, pole = height == 0, height > 1, owner == 3
    assert (moved[still & ~pole] == 0).all() and (moved[:, 2] == 0).all()
    shear = moved[1, :2] / height[1]
    rest = raised & ~pole
    assert moved[rest, :2] / height[rest, None] == pytest.approx(np.tile(shear, (rest.sum(), 1)))
    lean = moved[raised & pole, :2] / height[raised & pole, None] - shear
    assert np.ptp(lean, axis=0) == pytest.approx(0, abs=1e-9)
    assert np.abs(lean).max() > 1e-4


def test_drawn_poles_are_labelled_tree_and_drawn_trunks_pole():
    codes = [TAXONOMY[name] for name in ("light_pole", "tree", "car")]
    objects = pd.DataFrame({"label": np.repeat(codes, 40), "instance": np.arange(1, 121), "x": 0.0, "y": 0.0})
    instance = np.repeat(np.arange(1, 121), 2)
    truth = np.repeat(objects["label"].to_numpy(), 2)
    truth[81:160:2] = TAXONOMY["trunk"]  # a crown and a trunk of each tree
    logits = np.tile(np.arange(len(SCHEME), dtype=float), (240, 1))
    owner = np.arange(240)
    evidence = ClassEvidence(np.exp(logits), owner, group_shares(SCHEME))
    street = Street("s", np.zeros((240, 3)), np.zeros(3), np.zeros(240), evidence, truth, instance, objects, SCHEME)
    out = confuse_poles(street, logits, np.random.default_rng(2))
    tree, pole = SCHEME.classes.index("tree"), SCHEME.classes.index("pole")
    changed = out[:, tree] == pole
    assert ((out[:, pole] == tree) == changed).all()
    assert 18 <= changed[:80].sum() <= 46 and (changed[:80:2] == changed[1:80:2]).all()
    assert not changed[80:160:2].any() and 8 <= changed[81:160:2].sum() <= 25
    assert not changed[160:].any()


def test_drawn_signs_are_less_probable_than_what_they_hang_on_and_cubes_are_decoys():
    """Forty signs, then a wall of two thousand cubes, all with a sign certain or impossible."""
    n = 40 + 2000
    codes = [TAXONOMY["traffic_sign"]] * 40 + [TAXONOMY["building"]]
    objects = pd.DataFrame({"label": codes, "instance": np.arange(1, 42)})
    truth, instance = np.repeat(codes, [1] * 40 + [2000]), np.repeat(np.arange(1, 42), [1] * 40 + [2000])
    sign, building = SCHEME.classes.index("sign"), SCHEME.classes.index("building")
    logits = np.full((n, len(SCHEME)), -7.0)
    logits[:40, sign], logits[40:, building] = 0.0, 0.0
    evidence = ClassEvidence(np.exp(logits), np.arange(n), group_shares(SCHEME))
    street = Street("s", np.zeros((n, 3)), np.zeros(3), np.zeros(n), evidence, truth, instance, objects, SCHEME)
    middle = np.column_stack([np.arange(n) + 0.5, np.zeros(n), np.ones(n)])
    out = confuse_signs(street, logits, middle, np.random.default_rng(3))
    drawn = (out[:40] != logits[:40]).any(axis=1)
    doubt = out[:40][drawn].max(axis=1) - out[:40][drawn, sign]
    assert 8 <= drawn.sum() <= 25 and (doubt >= DOUBT[0]).all() and (doubt <= DOUBT[1]).all()
    decoy = out[40:, sign] > -7.0
    assert 1 <= decoy.sum() <= 20 and (out[40:][decoy].argmax(axis=1) == building).all()


def test_gaps_remove_strips_of_points_and_keep_their_columns_together(rng):
    local = np.column_stack([rng.uniform(0, 80, (4000, 2)), rng.uniform(0, 3, 4000)])
    number = np.arange(4000)
    evidence = ClassEvidence(np.full((4000, len(SCHEME)), 1 / len(SCHEME), np.float32), number, group_shares(SCHEME))
    street = Street("s", local, np.zeros(3), local[:, 2], evidence, number, number, pd.DataFrame(), SCHEME)
    cut = with_gaps(street, 5)
    assert 0.45 < len(cut.local) / 4000 < 0.85
    for column in (cut.truth, cut.evidence.owner):
        assert np.array_equal(column, cut.instance)
    assert np.array_equal(cut.local, local[cut.instance]) and np.array_equal(cut.height, local[cut.instance, 2])
    assert np.array_equal(with_gaps(street, 5).instance, cut.instance)
