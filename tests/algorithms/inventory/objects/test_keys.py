"""Keys of objects over several runs."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.inventory.objects.table import lasting_keys, new_keys

NONE = pd.DataFrame({"kind": [], "x": [], "y": [], "key": []})


@pytest.fixture
def street(rng):
    kinds = np.repeat(["pole", "sign", "tree", "vehicle"], 25)
    along = np.tile(np.arange(25) * 8.0, 4)
    return pd.DataFrame({"kind": kinds, "x": 5e5 + along, "y": 5e6 + np.repeat([0.0, 0.6, 12.0, 6.0], 25)})


def test_equal_objects_have_equal_keys_and_different_ones_different(street):
    keys = lasting_keys(street, NONE, crs="EPSG:25832")
    assert len({*keys}) == len(street)
    assert (lasting_keys(street, NONE, crs="EPSG:25832") == keys).all()
    assert not {*lasting_keys(street, NONE, crs="EPSG:25833")} & {*keys}


def test_other_objects_keep_their_keys_where_one_is_added_one_removed_and_all_are_measured_anew(street, rng):
    keys = lasting_keys(street, NONE)
    later = street.drop(index=10)
    later[["x", "y"]] += rng.uniform(-0.2, 0.2, (len(later), 2))
    later = pd.concat([pd.DataFrame({"kind": ["pole"], "x": [5e5 + 4.0], "y": [5e6]}), later], ignore_index=True)
    found = lasting_keys(later, street.assign(key=keys))
    assert (found[1:] == np.delete(keys, 10)).all()
    assert found[0] not in keys


def test_an_object_of_another_kind_keeps_its_key_nearby_unless_it_is_a_vehicle(street):
    earlier = street.assign(key=lasting_keys(street, NONE))
    now = pd.DataFrame({"kind": ["pole", "pole"], "x": 5e5 + np.array([0.3, 0.3]), "y": 5e6 + np.array([12.0, 6.0])})
    found = lasting_keys(now, earlier)
    assert found[0] == earlier["key"][50]
    assert found[1] not in {*earlier["key"]}


def test_the_first_inventory_with_an_object_gives_its_key(street):
    keys = lasting_keys(street, NONE)
    own = street.assign(key=[f"own{row}" for row in range(len(street))])
    found = lasting_keys(street, street.iloc[:40].assign(key=keys[:40]), own)
    assert (found[:40] == keys[:40]).all() and (found[40:] == own["key"][40:]).all()


def test_two_objects_at_one_place_have_two_keys():
    twice = pd.DataFrame({"kind": ["pole"] * 2, "x": [1.0] * 2, "y": [2.0] * 2})
    assert len({*lasting_keys(twice, NONE)}) == 2


def test_new_keys_leave_known_ones():
    table = pd.DataFrame({"kind": ["tree"] * 3, "x": [1.0, 1.0, 5.0], "y": [0.0] * 3, "key": ["a", "", ""]})
    keys = new_keys(table)
    assert keys[0] == "a"
    assert len({*keys}) == 3
    assert (new_keys(table, taken={keys[1]}) != keys).tolist() == [False, True, False]
