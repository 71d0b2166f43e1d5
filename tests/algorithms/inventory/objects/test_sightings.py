"""Files, passes and scanners of objects, against a count by sets."""

import numpy as np
import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.inventory.objects.sightings import (
    NO_TIME,
    PASS_GAP,
    SIGHTING_FIELDS,
    Sightings,
    mark_moving,
    sightings_of_scene,
    visit_columns,
    with_sightings,
)
from mlsroad_pipeline.algorithms.inventory.objects.table import OBJECT_FIELDS, SEEN_BY, empty_table
from mlsroad_pipeline.algorithms.scenes.weeks import dates_of


def cloud(**columns):
    n = len(next(iter(columns.values())))
    return PointCloud(np.zeros((n, 3), np.float32), {name: np.asarray(values) for name, values in columns.items()})


def objects(n):
    return pd.DataFrame({"object_id": np.arange(1, n + 1)}).reindex(columns=list(OBJECT_FIELDS))


def passes_by_sets(times):
    """Count intervals of whole seconds more than the gap apart."""
    seconds = sorted({int(np.floor(t)) for t in times})
    return sum(1 for i, t in enumerate(seconds) if i == 0 or t - seconds[i - 1] > PASS_GAP)


def test_objects_across_scenes_have_the_passes_scanners_and_files_of_their_points(rng):
    n_objects, scenes, seen = 6, [], []
    for number, name in enumerate(("a", "b", "c")):
        n = 4000
        part = rng.integers(-4, 4, n).astype(np.int32)
        own = rng.permutation(8)  # part -4..3 to object 0..7, of which 0 and 7 are none; some are in several scenes
        own = np.where(own == 7, 0, own)
        own[np.arange(-4, 4) == 0] = 0
        drive = rng.integers(0, 3, n)
        time = 1000.0 * drive + 20.0 * number + rng.random(n) * 8 + 90_000
        time[drive == 2] = np.where(own[part[drive == 2] + 4] % 2, time[drive == 2], 90_001.0)
        columns = {"gps_time": time, "scanner": (rng.integers(0, 2, n) * (own[part + 4] > 2)).astype(np.uint8)}
        file = (drive + (rng.random(n) < 0.2)).astype(np.int16)
        core = np.ones(n, bool)
        scene = cloud(**visit_columns(cloud(**columns)), file=file)
        scenes.append(Sightings(name, sightings_of_scene(part, scene, core)))
        numbers = np.zeros(8, np.uint32)
        numbers[np.arange(-4, 4)] = own
        seen.append((name, numbers, part, file, columns))
    table = with_sightings(objects(n_objects), {name: numbers for name, numbers, *_ in seen}, scenes)
    for number in range(1, n_objects + 1):
        row = table.iloc[number - 1]
        mine = [(f[n[p] == number], {k: v[n[p] == number] for k, v in c.items()}) for _, n, p, f, c in seen]
        there = [c for _, n, p, _, c in seen if (n[p] == number).any()]
        times = np.concatenate([c["gps_time"] for _, c in mine])
        assert row["file_count"] == len({*np.concatenate([f for f, _ in mine]).tolist()})
        assert row["passes"] == passes_by_sets(times)
        assert row["passes_there"] == passes_by_sets(np.concatenate([c["gps_time"] for c in there]))
        assert row["scanners"] == len({*np.concatenate([c["scanner"] for _, c in mine]).tolist()})
        assert row["scanners_there"] == len({*np.concatenate([c["scanner"] for c in there]).tolist()})
        assert (row["first_time"], row["last_time"]) == (np.floor(times.min()), np.floor(times.max()))
        assert row["first_date"] == dates_of(np.array([row["first_time"]]))[0]
    assert table["passes"].nunique() > 1 and table["scanners"].nunique() > 1  # the test has both cases


@pytest.mark.parametrize(
    ("columns", "passes", "there", "scanners"),
    [
        ({"gps_time": [0.0, 0.0, 0.0, 0.0], "point_source_id": np.uint16([7, 8, 8, 9])}, [2, 2], 3, 0),
        ({"point_source_id": np.uint16([0, 0, 0, 0])}, [1, 2], 2, 0),  # files alone
        ({}, [1, 2], 2, 0),
        ({"gps_time": [5.0, np.nan, 1e12, 90.0], "scanner_channel": np.uint8([1, 1, 0, 3])}, [1, 1], 2, 1),
    ],
    ids=["routes", "no routes", "nothing", "times not finite"],
)
def test_without_times_passes_are_routes_or_files(columns, passes, there, scanners):
    part, file = np.array([1, 1, 2, 2], np.int32), np.array([0, 0, 0, 1], np.int16)
    visits = visit_columns(cloud(**columns, row=np.zeros(4)))
    table = sightings_of_scene(part, cloud(**visits, file=file), np.ones(4, bool))
    found = with_sightings(objects(2), {"s": np.array([0, 1, 2], np.uint32)}, [Sightings("s", table)])
    assert found["passes"].tolist() == passes
    assert set(found["passes_there"]) == {there}
    assert found["scanners"].iloc[0] == scanners


def test_nothing_to_see():
    empty = sightings_of_scene(np.zeros(0, np.int32), cloud(file=np.zeros(0, np.int16)), np.zeros(0, bool))
    pd.testing.assert_frame_equal(empty, empty_table(SIGHTING_FIELDS))
    nothing = empty_table(OBJECT_FIELDS)
    pd.testing.assert_frame_equal(
        with_sightings(nothing, {"s": np.zeros(1, np.uint32)}, [Sightings("s", empty)]), nothing
    )
    assert visit_columns(cloud(gps_time=[np.inf, 1.0]))["second"].tolist() == [NO_TIME, 1]
    assert all(name in OBJECT_FIELDS for name in SEEN_BY)


def seen_objects(kinds, first, last, files=1):
    """Return a table of objects 5 m apart with the times that they were seen."""
    n = len(kinds)
    return pd.DataFrame({
        "kind": kinds, "x": 5.0 * np.arange(n), "y": np.zeros(n), "first_time": first, "last_time": last,
        "file_count": files,
    })  # fmt: skip


def test_a_vehicle_seen_for_a_moment_beside_poles_seen_for_seconds_moves():
    kinds = ["pole", "tree", "sign", "vehicle", "vehicle"]
    table = mark_moving(seen_objects(kinds, [0.0, 1.0, 0.0, 4.0, 0.0], [8.0, 9.0, 8.0, 5.0, 7.0]))
    assert table["motion"].tolist() == ["", "", "", "moving", ""]
    unknown = [np.nan] * 5
    table = mark_moving(seen_objects(kinds, unknown, unknown, files=[4, 4, 3, 1, 4]))
    assert table["motion"].tolist() == ["", "", "", "moving", ""]


def test_line_scanners_and_lonely_vehicles_decide_nothing():
    kinds = ["pole", "tree", "sign", "vehicle"]
    brief = mark_moving(seen_objects(kinds, [0.0, 1.0, 2.0, 3.0], [0.0, 2.0, 2.0, 3.0]))
    lonely = mark_moving(seen_objects(kinds[2:], [0.0, 3.0], [9.0, 3.0]))
    assert not brief["motion"].any() and not lonely["motion"].any()
