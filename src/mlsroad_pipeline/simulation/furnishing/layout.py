"""Layout of static objects in a street, block by block, each drawn from its own seed."""

from __future__ import annotations

from mlsroad_pipeline.simulation.furnishing import (
    corners,
    curbside,
    greenery,
    hard_cases,
    overhead,
    parking,
    premises,
    two_wheelers,
)
from mlsroad_pipeline.simulation.furnishing.placement import Placed, Site
from mlsroad_pipeline.simulation.street.street import Street


def populate(street: Street, block: int) -> list[Placed]:
    """Return all static objects of a block, numbered from ``-MARGIN``; the result is deterministic."""
    site = Site(street, block)
    corners.keep_clear(site)
    premises.build(site)
    corners.furnish(site)
    overhead.utility_line(site)
    overhead.over_the_road(site)
    curbside.lamps(site)
    curbside.bus_stops(site)
    parking.park(site)
    greenery.park_on_drives(site)
    curbside.tree_rows(site)
    curbside.furnish(site)
    curbside.plant_median(site)
    corners.furnish_side_streets(site)
    premises.plant_gardens(site)
    greenery.grow(site)
    hard_cases.add(site)
    two_wheelers.park(site)
    return site.placed
