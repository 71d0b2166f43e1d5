"""Every design of plants, people, two-wheelers and animals, over several seeds."""

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.simulation.model.meshes import BARK, FOLIAGE, KIND, LABEL, RED
from mlsroad_pipeline.simulation.objects import (
    animals,
    palms,
    people,
    shrubs,
    trees,
    two_wheelers,
)

MODULES = (animals, palms, people, shrubs, trees, two_wheelers)
DESIGNS = {design.name: design for module in MODULES for design in module.DESIGNS}
SEEDS = range(8)
LABELS = {
    "tree": {"tree", "trunk", "post"}, "palm": {"palm"}, "cycas": {"cycas"}, "brushwood": {"brushwood"},
    "person": {"person"}, "animal": {"animal"}, "bicycle": {"bicycle", "other_object"},
    "rider": {"rider", "bicycle", "motorcycle"}, "motorcycle": {"motorcycle"}, "other_vehicle": {"other_vehicle"},
}  # fmt: skip
BUDGET = {
    "tree": 6000, "palm": 6000, "cycas": 2600, "brushwood": 2500, "person": 830, "animal": 800, "bicycle": 800,
    "rider": 1800, "motorcycle": 1000, "other_vehicle": 300,
}  # fmt: skip
# Lowest and largest height, and largest width, metres: the bounds of the sources that the modules name.
SIZES = {
    "round_tree": (5.5, 14, 12), "mature_tree": (12, 21.5, 14.5), "small_round_tree": (3.7, 7.6, 6.6), "columnar_tree": (6.5, 15.5, 7),
    "vase_tree": (6.5, 15, 13), "pyramidal_tree": (6.3, 15, 10), "weeping_tree": (4.4, 11, 12),
    "multi_stem_tree": (3.7, 9, 9.3), "flowering_tree": (3.7, 9, 9), "young_staked_tree": (2.3, 5, 3),
    "bare_tree": (5.5, 14, 12), "spruce": (4.2, 15, 7.6), "pine": (5.8, 15, 11.5), "cedar": (6.3, 15, 13),
    "cypress": (3.8, 12.7, 3.2), "cone_conifer": (1.2, 4.4, 2.7), "royal_palm": (6.5, 17, 9.5),
    "date_palm": (4.5, 12.8, 9), "pygmy_date_palm": (1.8, 4.2, 3.5), "fan_palm": (4.8, 16.5, 5.3),
    "coconut_palm": (5, 15, 9.5), "clump_palm": (1.8, 5.6, 6.2), "young_palm": (0.7, 2.8, 5),
    "sago_cycas": (0.5, 1.9, 2.8), "tall_cycas": (1.2, 3.2, 3.1), "cycas_family": (0.5, 1.8, 2.6),
    "loose_bush": (0.45, 2.3, 2.6), "flowering_bush": (0.45, 2.3, 2.6), "clipped_ball": (0.4, 1.8, 2),
    "clipped_block": (0.5, 1.6, 2.1), "ground_cover": (0.1, 0.6, 3), "grass_tuft": (0.35, 1.95, 2.8),
    "leaf_rosette": (0.4, 1.9, 2.5), "standing_person": (1.49, 1.97, 1), "walking_person": (1.4, 1.97, 1.1),
    "running_person": (1.28, 1.97, 1.5), "talking_person": (1.49, 1.97, 1), "person_with_backpack": (1.4, 1.97, 1.1),
    "person_with_bag": (1.4, 1.97, 1.1), "person_with_suitcase": (1.4, 1.97, 1.7), "sitting_person": (1.1, 1.6, 1.1),
    "standing_child": (0.94, 1.47, 0.75), "walking_child": (0.9, 1.47, 0.85), "parked_bicycle": (0.7, 1.35, 1.95),
    "leaning_bicycle": (0.7, 1.35, 1.95), "hoop_bicycle": (0.7, 1.35, 1.95), "ridden_bicycle": (1.4, 2.05, 1.95),
    "kick_scooter": (0.9, 1.3, 1.3), "parked_motorcycle": (1.1, 1.6, 2.3), "parked_scooter": (1.1, 1.6, 2.05),
    "ridden_motorcycle": (1.45, 2.0, 2.3), "ridden_scooter": (1.4, 1.95, 2.05), "standing_dog": (0.2, 1.0, 1.6),
    "walking_dog": (0.2, 1.0, 1.6), "sitting_dog": (0.2, 0.95, 1.0), "lying_dog": (0.09, 0.5, 1.6),
    "standing_cat": (0.25, 0.45, 0.8), "sitting_cat": (0.25, 0.4, 0.5),
}  # fmt: skip


@pytest.fixture(scope="module")
def individuals():
    """Eight individuals of every design."""
    return {name: [d.build(np.random.default_rng(seed)) for seed in SEEDS] for name, d in DESIGNS.items()}


def test_every_design_has_its_sizes_and_no_name_twice():
    assert set(SIZES) == set(DESIGNS)
    assert len(DESIGNS) == sum(len(module.DESIGNS) for module in MODULES)


@pytest.mark.parametrize("name", DESIGNS)
def test_individuals_stand_at_the_origin_within_their_sizes(name, individuals):
    low, high, wide = SIZES[name]
    for mesh in individuals[name]:
        top = mesh.vertices[:, 2].max()
        assert low <= top <= high
        assert np.ptp(mesh.vertices[:, :2], axis=0).max() <= wide
        # Plants have roots; other objects touch the ground.
        assert -0.5 < mesh.vertices[:, 2].min() < 0.025
        foot = mesh.vertices[mesh.vertices[:, 2] < 0.3, :2]
        assert np.abs(foot).max() <= DESIGNS[name].clearance
        assert foot.min(axis=0).max() < 0.12 and foot.max(axis=0).min() > -0.12


@pytest.mark.parametrize("name", DESIGNS)
def test_faces_are_sound_and_within_budget(name, individuals):
    allowed = {TAXONOMY[label] for label in LABELS[DESIGNS[name].label]}
    for mesh in individuals[name]:
        assert np.isfinite(mesh.vertices).all() and np.isfinite(mesh.attributes).all()
        corners = mesh.vertices[mesh.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        assert area.min() > 1e-10
        assert len(np.unique(mesh.faces)) == mesh.faces.max() + 1 == len(mesh.vertices)
        assert len(mesh.faces) == len(mesh.attributes) <= BUDGET[DESIGNS[name].label]
        assert set(np.unique(mesh.attributes[:, LABEL]).astype(int)) <= allowed
        assert (mesh.attributes[:, RED:] > 0).all() and (mesh.attributes[:, RED:] <= 1).all()


@pytest.mark.parametrize("name", DESIGNS)
def test_one_stream_gives_one_individual_and_no_two_streams_the_same(name, individuals):
    again = DESIGNS[name].build(np.random.default_rng(SEEDS[0]))
    np.testing.assert_array_equal(again.vertices, individuals[name][0].vertices)
    np.testing.assert_array_equal(again.attributes, individuals[name][0].attributes)
    sizes = np.array([np.ptp(mesh.vertices, axis=0) for mesh in individuals[name]])
    tones = np.array([mesh.attributes[:, RED:].mean() for mesh in individuals[name]])
    assert len(np.unique(sizes.round(4), axis=0)) == len(sizes)
    assert len(np.unique(tones.round(5))) == len(tones)


@pytest.mark.parametrize("design", [d for d in DESIGNS.values() if d.label == "tree"], ids=lambda d: d.name)
def test_trunks_end_where_crowns_begin(design, individuals):
    for mesh in individuals[design.name]:
        is_trunk = mesh.attributes[:, LABEL] == TAXONOMY["trunk"]
        assert set(np.unique(mesh.attributes[is_trunk, KIND])) == {BARK}
        trunk = mesh.vertices[mesh.faces[is_trunk]]
        leaf = mesh.vertices[mesh.faces[mesh.attributes[:, KIND] == FOLIAGE]]
        crown = leaf if len(leaf) else mesh.vertices[mesh.faces[~is_trunk]]
        assert trunk[..., 2].max() < crown[..., 2].mean()
        assert trunk[..., 2].min() < 0 <= crown[..., 2].min()


@pytest.mark.parametrize("name", [d.name for d in trees.DESIGNS[:11] if d.name != "multi_stem_tree"])
def test_stems_have_the_girth_of_street_trees(name, individuals):
    for mesh in individuals[name]:
        codes = mesh.attributes[:, LABEL] == TAXONOMY["trunk"]
        trunk = mesh.vertices[np.unique(mesh.faces[codes])]
        # The nine corners of the cross-section below the crown.
        ring = trunk[trunk[:, 2].argsort()[-9:]]
        across = np.linalg.norm(ring[:, None] - ring, axis=2).max()
        assert 0.03 < across < 0.75
        assert across < np.ptp(mesh.vertices[:, :2], axis=0).min() / 8


def test_designs_for_moving_objects_are_never_parked():
    assert set(people.WALKERS) < {design.name for design in people.DESIGNS}
    for name in ("ridden_bicycle", "ridden_motorcycle", "ridden_scooter"):
        codes = np.unique(DESIGNS[name].build(np.random.default_rng(0)).attributes[:, LABEL])
        assert TAXONOMY["rider"] in codes and len(codes) == 2


@pytest.mark.parametrize("name", ["ridden_bicycle", "ridden_motorcycle", "ridden_scooter"])
def test_riders_touch_what_they_ride(name, individuals):
    for mesh in individuals[name]:
        corners = mesh.vertices[mesh.faces]
        rider = corners[mesh.attributes[:, LABEL] == TAXONOMY["rider"]].reshape(-1, 3)
        machine = corners[mesh.attributes[:, LABEL] != TAXONOMY["rider"]]
        # Broad faces have their corners far from a foot on them.
        shares = np.random.default_rng(0).dirichlet([1, 1, 1], 40)
        machine = np.concatenate([machine.reshape(-1, 3), np.einsum("sk,fkc->fsc", shares, machine).reshape(-1, 3)])
        for side in (-1, 1):
            # The hand is the foremost point above the knees.
            arm = rider[(side * rider[:, 1] > 0.12) & (rider[:, 2] > 0.85)]
            hand = arm[arm[:, 0].argmax()]
            assert np.linalg.norm(machine - hand, axis=1).min() < 0.16
            foot = rider[side * rider[:, 1] > 0.02]
            foot = foot[foot[:, 2].argmin()]
            assert np.linalg.norm(machine - foot, axis=1).min() < 0.2


@pytest.mark.parametrize("seed", range(6))
def test_people_who_talk_stand_apart_and_face_each_other(seed):
    ring = people.conversation(np.random.default_rng(seed))
    assert 2 <= len(ring) <= 4
    feet = np.array([m.vertices[m.vertices[:, 2] < 0.2, :2].mean(axis=0) for m in ring])
    heads = np.array([m.vertices[m.vertices[:, 2] > 0.85 * m.vertices[:, 2].max(), :2].mean(axis=0) for m in ring])
    gaps = np.linalg.norm(heads[:, None] - heads, axis=2)[~np.eye(len(ring), dtype=bool)]
    assert gaps.min() > 0.5
    assert np.linalg.norm(feet, axis=1).max() < 1.3


def test_labels_are_names_of_the_taxonomy():
    assert {design.label for design in DESIGNS.values()} == set(LABELS) <= set(TAXONOMY_NAMES.values())
