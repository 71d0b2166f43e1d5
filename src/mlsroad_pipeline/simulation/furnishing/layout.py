"""What stands in a street, and where: one block at a time, each drawn from its own seed."""

from __future__ import annotations

from mlsroad_pipeline.simulation.furnishing import (
    corners,
    curbside,
    hard_cases,
    overhead,
    parking,
    premises,
    two_wheelers,
)
from mlsroad_pipeline.simulation.furnishing.placement import Placed, Site
from mlsroad_pipeline.simulation.street.street import Street


def populate(street: Street, block: int) -> list[Placed]:
    """Return everything that stands still in a block.

    Parameters
    ----------
    street : Street
        The street.
    block : int
        Number of the block, from ``-MARGIN``.

    Returns
    -------
    list of Placed
        The objects; another call gives the same ones.
    """
    site = Site(street, block)
    corners.keep_clear(site)
    premises.build(site)
    corners.furnish(site)
    overhead.utility_line(site)
    overhead.over_the_road(site)
    curbside.lamps(site)
    curbside.bus_stops(site)
    parking.park(site)
    curbside.tree_rows(site)
    curbside.furnish(site)
    curbside.plant_median(site)
    corners.furnish_side_streets(site)
    premises.plant_gardens(site)
    hard_cases.add(site)
    two_wheelers.park(site)
    return site.placed
