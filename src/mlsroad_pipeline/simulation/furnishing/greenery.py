"""Overgrown property lines, forest edges, and cars on driveways, in streets whose parameters have them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.furnishing.premises import Frame, lots_of
from mlsroad_pipeline.simulation.plants.hedges import thicket
from mlsroad_pipeline.simulation.street.lots import Lot
from mlsroad_pipeline.simulation.street.street import generator

_SHRUBS = ("loose_bush", "flowering_bush", "ground_cover", "grass_tuft")
_SHRUB_WEIGHTS = (0.6, 0.2, 0.1, 0.1)
_TREES = ("multi_stem_tree", "small_round_tree", "round_tree", "columnar_tree", "flowering_tree", "bare_tree")
_WOODS = ("round_tree", "mature_tree", "multi_stem_tree", "bare_tree", "pyramidal_tree")
_FOREST_DEPTH = 14.0  # metres
_DRIVE = 2.3  # half of the length of street that a driveway keeps free, metres


def grow(site: Site) -> None:
    """Plant what overgrows the property lines of a block, and the edges of its woods."""
    parameters = site.parameters
    if parameters.greenery == 0 and parameters.forest == 0:
        return
    rng = generator(site.street.seed, 17, site.block)
    for lot, frame in lots_of(site):
        if lot.kind == "open" and parameters.forest > 0:
            _forest(site, lot, frame, parameters.forest, rng)
        elif lot.kind != "row" and parameters.greenery > 0:
            _overgrow(site, lot, frame, parameters.greenery, rng)


def _clear(lot: Lot, along: float) -> bool:
    """Return whether a place on a property line is off the driveway."""
    return not abs(along - lot.driveway) < _DRIVE


def _plant(site: Site, frame: Frame, names: str, along: float, beyond: float, rng: np.random.Generator) -> None:
    label = "tree" if "tree" in names else "brushwood"
    s, left = frame.place(along, beyond)
    site.try_add(catalogue.choose(label, rng, names), s, left, float(rng.uniform(0, 6.28)), edge=(0.1, 60.0))


def _walk(lot: Lot, step: tuple[float, float], rng: np.random.Generator, act: Callable[[float], None]) -> None:
    """Call a function at random steps along a lot, off its driveway."""
    at = lot.start + float(rng.uniform(*step)) / 2
    while at < lot.end - 0.4:
        if _clear(lot, at):
            act(at)
        at += float(rng.uniform(*step))


def _overgrow(site: Site, lot: Lot, frame: Frame, share: float, rng: np.random.Generator) -> None:
    """Plant shrubs close to a boundary, on both of its sides, and low trees that overhang it."""
    deep = max(lot.setback - 1.0, 1.2)

    def shrub(at: float) -> None:
        if rng.random() < share:
            name = str(rng.choice(_SHRUBS, p=_SHRUB_WEIGHTS))
            _plant(site, frame, name, at, float(rng.uniform(-0.1, min(deep, 2.0))), rng)

    def tree(at: float) -> None:
        if rng.random() < share:
            _plant(site, frame, str(rng.choice(_TREES)), at, float(rng.uniform(0.7, min(deep, 2.5))), rng)

    _walk(lot, (0.9, 2.2), rng, shrub)
    _walk(lot, (5.0, 11.0), rng, tree)


def _forest(site: Site, lot: Lot, frame: Frame, density: float, rng: np.random.Generator) -> None:
    """Plant undergrowth along the edge of a wood, and trees behind it."""
    height, depth = float(rng.uniform(0.8, 2.2)), float(rng.uniform(0.8, 1.8))

    def edge(at: float) -> None:
        if rng.random() < 0.8 * density:
            length = float(rng.uniform(2.0, 4.0))
            mesh = thicket(rng, length, height=height * float(rng.uniform(0.5, 1.4)), depth=depth)
            s, left = frame.place(at, depth / 2 + float(rng.uniform(0.0, 1.5)))
            site.add(("thicket", "hedge"), mesh, s, left, frame.yaw, tilt=True, numbered=False, solid=False)

    def tree(at: float) -> None:
        if rng.random() < density:
            name = str(rng.choice(_WOODS))
            _plant(site, frame, name, at, float(rng.uniform(1.0, _FOREST_DEPTH)), rng)

    _walk(lot, (1.5, 3.0), rng, edge)
    _walk(lot, (0.8, 2.0), rng, tree)


def park_on_drives(site: Site) -> None:
    """Park cars on driveways."""
    share = site.parameters.drive_cars
    if share == 0:
        return
    rng = generator(site.street.seed, 18, site.block)
    for lot, frame in lots_of(site):
        if not np.isfinite(lot.driveway) or rng.random() >= share:
            continue
        design = catalogue.choose("car" if rng.random() < 0.85 else "van", rng)
        s, left = frame.place(lot.driveway + float(rng.normal(0, 0.15)), float(rng.uniform(2.9, 4.2)))
        yaw = site.toward_road(left) + (np.pi if rng.random() < 0.6 else 0.0) + float(rng.normal(0, 0.05))
        site.try_add(design, s, left, yaw, edge=(0.3, 60.0), tilt=True)
