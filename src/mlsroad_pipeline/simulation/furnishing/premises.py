"""Objects beyond the property line: buildings, fences, walls, hedges, gardens, overgrowth, woods, cars on driveways."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from mlsroad_pipeline.simulation.furnishing import buildings, catalogue
from mlsroad_pipeline.simulation.furnishing.corners import SideStreet
from mlsroad_pipeline.simulation.furnishing.placement import Site
from mlsroad_pipeline.simulation.plants.crowns import hedge, thicket
from mlsroad_pipeline.simulation.street.ground import STATION
from mlsroad_pipeline.simulation.street.street import Lot, generator

_PIECE = 4.0  # length of a piece of fence, wall or hedge, metres
_SHRUBS = ("loose_bush", "flowering_bush", "ground_cover", "grass_tuft")
_SHRUB_WEIGHTS = (0.6, 0.2, 0.1, 0.1)
_TREES = ("multi_stem_tree", "small_round_tree", "round_tree", "columnar_tree", "flowering_tree", "bare_tree")
_WOODS = ("round_tree", "mature_tree", "multi_stem_tree", "bare_tree", "pyramidal_tree")
_FOREST_DEPTH = 14.0  # metres
_DRIVE = 2.3  # half of the length of street that a driveway keeps free, metres


class Frame:
    """Frame of a lot: along its own street, and away from that street's property line."""

    def __init__(self, site: Site, lot: Lot) -> None:
        ground, self.way = site.street.ground, 1.0 if lot.side == 0 else -1.0
        self.road = SideStreet(site, ground.arms[lot.arm]) if lot.arm >= 0 else None
        if self.road is None:
            self.line, self.yaw = ground.property_line(lot.side), 0.0 if lot.side == 0 else np.pi
            return
        self.line = float(self.road.width + ground.section[0 if self.road.way > 0 else 1, 2:].sum())
        # Fronts face the side street.
        self.yaw = self.road.outward if self.way != self.road.way else self.road.outward + np.pi

    def place(self, along: float, beyond: float) -> tuple[float, float]:
        """Return station and offset of a place `beyond` metres behind the property line."""
        left = self.way * (self.line + beyond)
        return (along, left) if self.road is None else self.road.place(along, left)


def lots_of(site: Site) -> list[tuple[Lot, Frame]]:
    """Return the lots of a block with their frames."""
    arms = site.street.ground.arms
    lots = []
    for lot in site.street.lots:
        s = (lot.start + lot.end) / 2 if lot.arm < 0 else float(arms[lot.arm, STATION])
        if site.start <= s < site.end:
            lots.append((lot, Frame(site, lot)))
    return lots


def build(site: Site) -> None:
    """Build the houses of a block and the boundaries of its lots."""
    for lot, frame in lots_of(site):
        if lot.kind != "open":
            _house(site, lot, frame)
        _boundary(site, lot, frame)


def _house(site: Site, lot: Lot, frame: Frame) -> None:
    rng, length = site.rng, lot.end - lot.start
    row = lot.kind == "row"
    gap = 0.0 if row else float(rng.uniform(1.0, 3.0))
    plinth = float(rng.uniform(0.15, 0.3)) if row else float(rng.choice([0.0, 0.3, 0.6, 0.9]))
    mesh = buildings.building(
        rng, max(length - gap, 4.0), shop=row and rng.random() < 0.45, plinth=0.0 if row else plinth,
        storeys=site.parameters.storeys,
    )  # fmt: skip
    s, left = frame.place((lot.start + lot.end) / 2, lot.setback)
    site.add(("building", "building"), mesh, s, left, frame.yaw, numbered=False)


def _boundary(site: Site, lot: Lot, frame: Frame) -> None:
    """Place one design of fence, wall or hedge along a lot, in pieces that follow the ground.

    Hedges of overgrown streets are trimmed rarely, and as high as the street's greenery makes them.
    """
    if lot.boundary == "none":
        return
    state, beyond = int(site.rng.integers(2**31)), 0.3
    make = {"fence": buildings.fence, "wall": buildings.wall, "hedge": hedge}[lot.boundary]
    share, rng = site.parameters.greenery if lot.boundary == "hedge" else 0.0, None
    if share > 0:
        rng = np.random.default_rng(int(site.rng.integers(2**31)))
        height, depth = rng.uniform(0.8, 1.6 + 1.4 * share), rng.uniform(0.6, 0.9 + 0.9 * share)
        make, beyond = partial(thicket, height=float(height), depth=float(depth)), 0.1 + float(depth) / 2
    gate = (lot.driveway - 1.6, lot.driveway + 1.6) if np.isfinite(lot.driveway) else (lot.end, lot.end)
    for low, high in ((lot.start, gate[0]), (gate[1], lot.end)):
        if high - low < 0.6:
            continue
        for a, b in pairwise(np.linspace(low, high, max(round((high - low) / _PIECE), 1) + 1)):
            # Trimmed pieces begin in the same state: they are of one design.
            mesh = make(rng or np.random.default_rng(state), float(b - a))
            s, left = frame.place(float(a + b) / 2, beyond)
            site.add((lot.boundary, lot.boundary), mesh, s, left, frame.yaw, tilt=True, numbered=False)


def plant_gardens(site: Site) -> None:
    """Plant trees, palms and shrubs in front gardens and on open land."""
    rng, parameters = site.rng, site.parameters
    weights = np.array([parameters.trees, parameters.palms, 2.0 * parameters.shrubs])
    if weights.sum() == 0:
        return
    for lot, frame in lots_of(site):
        deep = lot.setback - 1.2 if lot.kind == "house" else 14.0 if lot.kind == "open" else 0.0
        if deep <= 1.0:
            continue
        count = int(rng.integers(1, 5 if deep < 8 else 8))
        for label in rng.choice(["tree", "palm", "brushwood"], count, p=weights / weights.sum()):
            along, beyond = rng.uniform(lot.start + 0.8, lot.end - 0.8), 0.9 + rng.uniform(0.2, deep)
            s, left = frame.place(float(along), float(beyond))
            design = catalogue.choose(str(label), rng)
            site.try_add(design, s, left, float(rng.uniform(0, 6.28)), edge=(0.3, 60.0))


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


def _plant(site: Site, frame: Frame, names: str, along: float, beyond: float, rng: np.random.Generator) -> None:
    label = "tree" if "tree" in names else "brushwood"
    s, left = frame.place(along, beyond)
    site.try_add(catalogue.choose(label, rng, names), s, left, float(rng.uniform(0, 6.28)), edge=(0.1, 60.0))


def _walk(lot: Lot, step: tuple[float, float], rng: np.random.Generator, act: Callable[[float], None]) -> None:
    """Call a function at random steps along a lot, off its driveway."""
    at = lot.start + float(rng.uniform(*step)) / 2
    while at < lot.end - 0.4:
        if not abs(at - lot.driveway) < _DRIVE:  # also without a driveway, which is NaN
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
