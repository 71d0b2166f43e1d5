"""Another year of a block: what stays keeps its number, and every kind of change occurs."""

from dataclasses import replace

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation import PRESETS, another_year
from mlsroad_pipeline.simulation.furnishing.blocks import populate
from mlsroad_pipeline.simulation.furnishing.years import DISTANCE, GROWTH, LEAN
from mlsroad_pipeline.simulation.parameters.street_parameters import StreetParameters
from mlsroad_pipeline.simulation.street.street import draw_street

KIND = StreetParameters(lamp_spacing=10.0, signs=3.0, trees=2.0)


def built(year, blocks=range(4)):
    street = draw_street(5, length=240.0, parameters=replace(KIND, year=year))
    return {p.instance: p for block in blocks for p in populate(street, block) if p.instance}


@pytest.fixture(scope="module")
def years():
    return built(0), built(1)


def test_objects_are_gone_new_moved_leaned_and_grown(years):
    before, after = years
    lasting = {n for n, p in before.items() if p.design.endswith(("lamp", "sign", "tree", "palm"))}
    assert lasting - after.keys() and after.keys() - before.keys() and len(lasting & after.keys()) > 0.8 * len(lasting)
    moved, leaned, grown, same = [], [], [], 0
    for number in lasting & after.keys():
        one, other = before[number], after[number]
        way = np.hypot(*(other.base - one.base)[:2])
        local = [p.mesh.vertices - p.base for p in (one, other)]
        length = [np.linalg.norm(part, axis=1).max() for part in local]
        if way > 0:
            moved.append(way)
            assert np.allclose(*local, atol=1e-6)
        elif not np.isclose(*length, rtol=1e-6):
            grown.append(length[1] / length[0])
            assert np.allclose(local[1], local[0] * grown[-1]) and other.box.height > one.box.height
        elif not np.allclose(*local, atol=1e-9):
            # The rotation from one mesh to the other, by singular value decomposition.
            u, _, v = np.linalg.svd(local[0].T @ local[1])
            leaned.append(np.degrees(np.arccos(np.clip((u @ v)[2, 2], -1, 1))))
        else:
            same += 1
    assert min(moved) > DISTANCE[0] * 0.8 and max(moved) < DISTANCE[1] * 1.2
    assert LEAN[0] <= min(leaned) and max(leaned) <= LEAN[1] and len(leaned) > 5
    assert GROWTH[0] <= min(grown) and max(grown) <= GROWTH[1] and same > 10


def test_what_hangs_on_a_lamp_changes_with_it(years):
    before, after = years
    plates = [n for n, p in before.items() if p.design == "plate_on_lamp"]
    assert plates
    for number in plates:
        lamp = next(n for n, p in before.items() if n != number and np.allclose(p.base, before[number].base))
        assert (number in after) == (lamp in after)
        if number in after:
            assert np.allclose(after[number].base, after[lamp].base)


def test_a_year_is_always_the_same_and_unlike_others(years):
    again, other = built(1, blocks=[2]), built(2, blocks=[2])
    before = {n: p for n, p in years[1].items() if min(again) <= n <= max(again)}
    assert again.keys() == before.keys() != other.keys()
    assert all(np.array_equal(again[n].mesh.vertices, before[n].mesh.vertices) for n in again)


def test_cars_are_parked_anew(years):
    cars = [
        {tuple(p.base.round(3)) for p in year.values() if p.design in ("sedan", "hatchback", "suv")} for year in years
    ]
    assert cars[0] and cars[1] and not cars[0] & cars[1]


def test_parameters_of_another_year():
    first = PRESETS["tiny"]
    later = another_year(first, 3, offset=(0.5, 0, -0.25), scanner=PRESETS["hdl32"].scanner)
    assert later.street == replace(first.street, year=3) and later.first_pass == 3 and later.seed == first.seed
    assert later.easting == first.easting + 0.5 and later.height == first.height - 0.25
    assert later.pulse_rate is None and first.pulse_rate is not None
    for year in (-1, 1000, 1.5, True):
        with pytest.raises(ParameterError, match="year must be an integer from 0 to 999"):
            StreetParameters(year=year)
    with pytest.raises(ParameterError, match="first_pass"):
        another_year(first, 201)
