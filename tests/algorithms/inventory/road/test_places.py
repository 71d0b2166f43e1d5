"""Places of a planted road: intrusions and low places by object, and the measures every ten metres."""

import numpy as np
import pandas as pd
import pytest
from helpers.roads import planted_road

from mlsroad_pipeline.algorithms.inventory.road.places import PLACE_FIELDS, road_places


@pytest.fixture(scope="module")
def places():
    return road_places(*planted_road(), least_clearance=4.0)


def of_state(places, state):
    return places[places["state"] == state]


def test_stations_in_a_row_are_one_place_at_its_lowest_point(places):
    first, second = of_state(places, "intruded").to_dict("records")
    assert (first["place"], first["from_station"], first["to_station"]) == ("6.5", 5.0, 8.0)
    assert (first["x"], first["y"], first["z"]) == (506.5, 896.0, 15.1)
    assert first["reason"] == "tree 4, 3.10 m above the road, 1.0 m right"
    assert (second["place"], second["object_id"], second["reason"][:5]) == ("12.5", 0, "sign,")


def test_what_is_in_the_envelope_is_not_low_too(places):
    (low,) = of_state(places, "low").to_dict("records")
    assert (low["place"], low["from_station"], low["to_station"], low["height"]) == ("15.5", 15.0, 16.0, 3.8)
    assert low["y"] == 899.5 and low["reason"] == "tree, 3.80 m above the road, 2.5 m left"


def test_every_ten_metres_have_medians_and_the_least_clearance(places):
    measured = of_state(places, "measured")
    assert measured[["place", "from_station", "to_station"]].to_numpy().tolist() == [
        ["0", 0.0, 10.0], ["10", 10.0, 20.0], ["20", 20.0, 25.0],
    ]  # fmt: skip
    assert measured["reason"].tolist() == [
        "width 6.50 m, crossfall 2.50 %, clearance 3.10 m", "width 6.50 m, crossfall 2.50 %, clearance 3.40 m",
        "not seen",
    ]  # fmt: skip
    assert measured["x"].tolist() == [505.5, 515.5, 522.5]


def test_another_least_clearance_and_a_road_without_an_envelope():
    table, path = planted_road()
    table = table.assign(envelope="")
    assert set(road_places(table, path, least_clearance=3.0)["state"]) == {"measured"}
    low = of_state(road_places(table, path), "low")
    assert low["place"].tolist() == ["6.5", "12.5", "15.5"] and low["object_id"].tolist() == [4, 0, 0]
    assert list(low) == [name for name in PLACE_FIELDS if name != "checked"]


def test_objects_and_gaps_divide_places_and_stations_between_do_not():
    table, path = planted_road()
    rows = np.arange(len(table))
    inside = np.isin(rows, [1, 2, 4, 5, 9])
    number = np.where(rows < 5, 4, 6)
    table = table.assign(
        envelope=np.where(inside, "intruded", "free"), intrusion=np.where(inside, 3.0, np.nan), clearance=np.nan,
        intrusion_offset=0.0, intrusion_class="tree", intrusion_object=np.where(inside, number, 0),
    )  # fmt: skip
    found = of_state(road_places(table, path), "intruded")
    pairs = found[["from_station", "to_station", "object_id"]].to_numpy(dtype=int).tolist()
    assert pairs == [[1, 5, 4], [5, 6, 6], [9, 10, 6]]


def test_an_empty_road_has_no_places():
    table, path = planted_road()
    assert road_places(pd.DataFrame(table.iloc[:0]), path)["place"].tolist() == []
