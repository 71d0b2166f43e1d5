"""Keys of scenes in the stores: parsed, formatted and grouped."""

import pytest

from mlsroad_pipeline.algorithms.core.scene_key import SceneKey, group_by_split


@pytest.mark.parametrize(
    ("key", "split", "source", "part", "parent"),
    [
        ("train.drive_1.scene_000003", "train", "drive_1", "scene_000003", "train.drive_1"),
        ("survey.street_laz.000000500000", "survey", "street_laz", "000000500000", "survey.street_laz"),
        ("test._", "test", "_", "", "test._"),
        ("fold1", "fold1", "", "", "fold1"),
    ],
)
def test_a_key_is_parsed_and_formatted_again(key, split, source, part, parent):
    parsed = SceneKey.parse(key)
    assert (parsed.split, parsed.source, parsed.part, parsed.parent) == (split, source, part, parent)
    assert str(parsed) == key


def test_results_are_grouped_by_split_in_their_order():
    results = {"train.a.0": 1, "test.a.0": 2, "train.b.0": 3, "training.a.0": 4}
    assert group_by_split(results) == {"train": [1, 3], "test": [2], "training": [4]}
