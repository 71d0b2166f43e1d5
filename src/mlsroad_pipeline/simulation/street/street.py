"""Street drawn from a seed: alignment, profile, cross-section, side streets, crossings, and lots beside it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.simulation.parameters.street_parameters import StreetParameters
from mlsroad_pipeline.simulation.street.alignment import STEP, Alignment
from mlsroad_pipeline.simulation.street.ground import (
    CONTROL,
    CURB,
    GIVE_WAY,
    GRASS,
    HALF_WIDTH,
    LANE_MARKING,
    MANHOLE,
    OTHER_GROUND,
    PARKING,
    RADIUS,
    ROAD,
    SIDE,
    SIDEWALK,
    SIGNALS,
    SKEW,
    SOIL,
    STATION,
    STOP,
    ZEBRA_HALF,
    Ground,
)  # fmt: skip

_BEHIND_CORNER = 22.0  # land of the main street's lots, from the property line on, metres
_END = 52.0  # side streets are built on up to here, metres from the main street's axis

BLOCK = 60.0  # Length of the blocks of a street, metres
MARGIN = 3  # Blocks of street before the survey's start and after its end
HALF_DEPTH = 55.0  # Width of the ground on either side of the centre line, metres


@dataclass(frozen=True)
class Lot:
    """Lot beside the street, or beside a side street."""

    side: int  # 0 is left, 1 is right; of a side street, 0 is the side ahead along the main street
    # start, end: stations, metres; of a side street, distances beyond the main carriageway
    start: float
    end: float
    kind: str  # ``"row"`` (facade at the pavement), ``"house"`` (behind a front garden) or ``"open"``
    boundary: str  # Boundary on the property line: ``"fence"``, ``"wall"``, ``"hedge"`` or ``"none"``
    setback: float  # Distance of the building from the property line, metres
    driveway: float  # Station of the driveway's middle, NaN without one
    arm: int = -1  # Row of the side street in `Ground.arms`; -1 is the main street


def free_land(
    side: int, start: float, end: float, section: NDArray[np.float64], arms: NDArray[np.float64]
) -> list[tuple[float, float]]:
    """Return start and end of the stretches of one side of a street between its side streets; side 0 is left."""
    width = float(section[side, 2:].sum())
    stretches, at = [], start
    for arm in arms[arms[:, SIDE] == side]:
        # Corners of buildings keep clear of the rounded corner of the pavement; skewed streets need more room.
        margin = arm[HALF_WIDTH] + width + 0.45 * max(arm[RADIUS] - width, 0.0) + abs(arm[SKEW]) * 20.0 + 0.6
        stretches.append((at, float(arm[STATION] - margin)))
        at = float(arm[STATION] + margin)
    return [*stretches, (at, end)]


def _drawn(
    rng: np.random.Generator, side: int, stretch: tuple[float, float], parameters: StreetParameters, arm: int,
    shares: NDArray[np.float64], edges: NDArray[np.float64],
) -> list[Lot]:  # fmt: skip
    lots, (at, end) = [], stretch
    while end - at > 5.0:
        stop = at + rng.uniform(9, 20)
        if end - stop < 6.0:
            stop = end
        kind = str(rng.choice(("row", "house", "open"), p=shares))
        if rng.random() >= parameters.buildings or stop - at > 26.0:
            kind = "open"
        boundary = "none" if kind == "row" else str(rng.choice(("fence", "wall", "hedge", "none"), p=edges))
        if parameters.boundaries < 1.0 and rng.random() >= parameters.boundaries:
            boundary = "none"
        setback = rng.uniform(0.1, 0.5) if kind == "row" else rng.uniform(3.5, 7.5)
        if kind != "row" and parameters.front_yard > 0:
            setback = parameters.front_yard * rng.uniform(0.7, 1.3)
        has_driveway = arm < 0 and kind != "row" and rng.random() < 0.6 * min(parameters.buildings, 1.0)
        driveway = rng.uniform(at + 3.2, stop - 3.2) if has_driveway and stop - at > 7 else np.nan
        lots.append(Lot(side, at, stop, kind, boundary, setback, float(driveway), arm))
        at = stop
    return lots


def draw_lots(
    rng: np.random.Generator, side: int, start: float, end: float, section: NDArray[np.float64],
    arms: NDArray[np.float64], parameters: StreetParameters,
) -> list[Lot]:  # fmt: skip
    """Draw the lots on one side of a street, then those on both sides of its side streets there."""
    shares, edges = rng.dirichlet([2.5, 2.5, 0.8]), rng.dirichlet([2.0, 2.0, 2.0, 0.7])
    if parameters.facades >= 0:
        shares = np.array([parameters.facades, 1.0 - parameters.facades, 0.0])
    if parameters.hedges >= 0:
        edges = np.append((1.0 - parameters.hedges) * edges[:2] / edges[:2].sum(), [parameters.hedges, 0.0])
    lots: list[Lot] = []
    for stretch in free_land(side, start, end, section, arms):
        lots += _drawn(rng, side, stretch, parameters, -1, shares, edges)
    behind = float(section[side, 2:].sum()) + _BEHIND_CORNER
    for k in np.flatnonzero(arms[:, SIDE] == side):
        for flank in range(2):
            stretch = (behind, _END - float(section[side, 0]))
            lots += _drawn(rng, flank, stretch, parameters, int(k), shares, edges)
    return lots


@dataclass(frozen=True)
class Street:
    """A street."""

    seed: int  # Its seed
    alignment: Alignment  # Centre line
    ground: Ground  # Ground
    lots: tuple[Lot, ...]  # Lots on both sides
    ground_rgb: NDArray[np.float64]  # Albedo of each ground surface by taxonomy code
    ground_reflectivity: NDArray[np.float64]  # Albedo at the scanner's wavelength
    parameters: StreetParameters  # Parameters of its kind

    def on_ground(self, station: float, offset: float) -> tuple[NDArray[np.float64], float]:
        """Return a place on the ground, street-local metres, and the heading of the street there."""
        xy, heading = self.alignment.place([station], [offset])
        return np.array([*xy[0], self.ground.height([station], [offset])[0]]), float(heading[0])

    def kerb_zone(self, side: int) -> float:
        """Return the offset of the line of trees, lamps and signs along the curb."""
        half, _, curb, verge, _ = self.ground.section[side]
        offset = half + curb + (verge / 2 if verge > 0 else 0.45)
        return float(offset if side == 0 else -offset)


def generator(seed: int, *path: int) -> np.random.Generator:
    """Return the random generator of one part, a `path` of numbers from -1024 on; parts share no random numbers."""
    return np.random.default_rng([seed, *(p + 1024 for p in path)])


def _section(rng: np.random.Generator, parameters: StreetParameters) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    lanes = 1 + int(rng.random() < 0.3)
    lane = rng.uniform(3.1, 3.6)
    lanes, median = parameters.lanes or lanes, parameters.median / 2
    lane = parameters.lane_width * rng.uniform(0.95, 1.05) if parameters.lane_width > 0 else lane
    slanted = rng.random() < parameters.slanted_parking
    rows = []
    for chance in rng.random((2, 2)):
        depth = rng.uniform(4.9, 5.4) if slanted else rng.uniform(2.05, 2.4)
        bay = depth if chance[0] < parameters.parking else 0.0
        has_verge = chance[1] < parameters.verges
        strip = parameters.verge_width * rng.uniform(0.7, 1.3) if has_verge else 0.0
        pavement = rng.uniform(1.9, 2.8) if has_verge else rng.uniform(2.6, 3.8)
        if parameters.pavement > 0:
            pavement = parameters.pavement * rng.uniform(0.8, 1.2)
        rows.append([median + lanes * lane + bay, bay, rng.uniform(0.13, 0.28), strip, pavement])
    shape = [
        rng.uniform(0.015, 0.028), rng.uniform(-0.012, 0.012), rng.uniform(0.08, 0.16), lane, lanes, median,
        rng.uniform(0.35, 0.7) if slanted else 0.0, parameters.grass_height,
    ]  # fmt: skip
    return np.array(rows), np.array(shape)


def _arms(
    rng: np.random.Generator, alignment: Alignment, blocks: range, parameters: StreetParameters
) -> NDArray[np.float64]:
    """Draw side streets; each joins near the middle of a block, so that its corners are within it."""
    rows: list[list[float]] = []
    if parameters.junction_spacing == 0:
        return np.zeros((0, 9))
    at = blocks[0] * BLOCK + rng.uniform(0.2, 1.0) * parameters.junction_spacing
    while at < blocks[-1] * BLOCK:
        station = (np.floor(at / BLOCK) + 0.5) * BLOCK + rng.uniform(-5, 5)
        row = int((station - alignment.start) / STEP)
        curvature = float(alignment.table[row + 1, 2] - alignment.table[row, 2]) / STEP
        control = SIGNALS if rng.random() < parameters.signals else int(rng.integers(GIVE_WAY, STOP + 1))
        sides = (0, 1) if rng.random() < parameters.crossroads else (int(rng.integers(2)),)
        skew = rng.uniform(-0.16, 0.16)
        for side in sides:
            radius = rng.uniform(4.5, 7.5)
            zebra = radius + 0.6 + ZEBRA_HALF if rng.random() < 0.6 or control == SIGNALS else 0.0
            slant = skew if side == 0 else -skew + rng.uniform(-0.03, 0.03)
            width = rng.uniform(2.9, 4.2)
            rows.append([station, side, width, radius, slant, curvature, control, zebra, rng.uniform(0.015, 0.03)])
        at = station + max(parameters.junction_spacing * rng.uniform(0.6, 1.4), BLOCK)
    return np.array(rows).reshape(-1, 9)


def _profile(rng: np.random.Generator, station: NDArray[np.float64]) -> NDArray[np.float64]:
    wavelength = rng.uniform([120.0, 260.0], [240.0, 600.0])
    grade = rng.uniform(0.006, 0.028, 2)
    z = rng.uniform(-0.02, 0.02) * station
    z = z + (grade * wavelength / (2 * np.pi) * np.sin(
        2 * np.pi * station[:, None] / wavelength + rng.uniform(0, 6.28, 2))).sum(axis=1)  # fmt: skip
    columns = [z, np.ones_like(z), np.ones_like(z)]
    for _ in range(2):
        waves = rng.uniform(0.02, 0.09, 2) * np.sin(
            2 * np.pi * station[:, None] / rng.uniform(60, 220, 2) + rng.uniform(0, 6.28, 2)
        )
        columns.append(rng.uniform(-0.03, 0.08) + waves.sum(axis=1))
    return np.stack(columns, axis=1)


def _surfaces(
    rng: np.random.Generator, station: NDArray[np.float64], lots: list[Lot], profile: NDArray[np.float64], soil: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    verge = np.empty((2, len(station)), dtype=np.uint8)
    lot_codes = np.full((2, len(station)), GRASS, dtype=np.uint8)
    for side in range(2):
        at = 0
        while at < len(station):
            run = int(rng.uniform(8, 30) / STEP)
            verge[side, at : at + run] = SOIL if rng.random() < soil else GRASS
            at += run
    for lot in lots:
        if lot.arm >= 0:
            continue
        rows = slice(*np.searchsorted(station, [lot.start, lot.end]))
        share = [0.15, 0.1, 0.75] if lot.kind == "row" else [0.82 * (1 - soil), 0.82 * soil, 0.18]
        lot_codes[lot.side, rows] = rng.choice([GRASS, SOIL, OTHER_GROUND], p=share)
        if np.isfinite(lot.driveway):
            distance = np.abs(station - lot.driveway)
            lot_codes[lot.side, distance < 1.6] = OTHER_GROUND
            verge[lot.side, distance < 1.6] = OTHER_GROUND
            dropped = np.clip((distance - 1.7) / 0.8, 0.15, 1.0)
            profile[:, 1 + lot.side] = np.minimum(profile[:, 1 + lot.side], dropped)
    return verge, lot_codes


def _ground_materials(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Linear albedo and reflectivity near 1550 nm; asphalt ages from dark to light, soil and grass differ by place.
    base = {
        ROAD: ((0.11, 0.11, 0.112), 0.20), PARKING: ((0.13, 0.128, 0.125), 0.22), LANE_MARKING: ((0.55,) * 3, 0.5),
        SIDEWALK: ((0.30, 0.28, 0.26), 0.33), CURB: ((0.34, 0.33, 0.31), 0.36), MANHOLE: ((0.09, 0.085, 0.08), 0.16),
        GRASS: ((0.11, 0.19, 0.055), 0.42), SOIL: ((0.21, 0.15, 0.10), 0.36), OTHER_GROUND: ((0.24, 0.22, 0.2), 0.3),
    }  # fmt: skip
    rgb, reflectivity = np.full((256, 3), 0.2), np.full(256, 0.3)
    for code, (colour, near_infrared) in base.items():
        rgb[code] = np.clip(np.array(colour) * np.exp(rng.normal(0, 0.22)) * np.exp(rng.normal(0, 0.035, 3)), 0.01, 0.9)
        reflectivity[code] = np.clip(near_infrared * np.exp(rng.normal(0, 0.2)), 0.04, 0.9)
    return rgb, reflectivity


def _crossings(rng: np.random.Generator, start: float, end: float, arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Draw zebra crossings: before junctions, and some between them."""
    crossings = []
    for station in np.unique(arms[:, STATION]):
        joined = arms[arms[:, STATION] == station]
        away = float((joined[:, HALF_WIDTH] + joined[:, RADIUS]).max()) + 2.4
        for direction in (-1, 1):
            if joined[0, CONTROL] == SIGNALS or rng.random() < 0.35:
                crossings.append((float(station) + direction * away, float(rng.uniform(1.4, 2.0))))
    at = start + float(rng.uniform(20, 120))
    while at < end:
        if len(arms) == 0 or np.abs(arms[:, STATION] - at).min() > 32:
            crossings.append((at, float(rng.uniform(1.4, 2.2))))
        at += float(rng.uniform(80, 180))
    return np.array(sorted(crossings)).reshape(-1, 2)


def _lids(
    rng: np.random.Generator, start: float, end: float, section: NDArray[np.float64], median: float, radius: float
) -> NDArray[np.float64]:
    """Draw manholes in the lanes and drains in the gutters."""
    stations = np.cumsum(rng.uniform(9, 30, int((end - start) / 9))) + start
    offsets = rng.uniform(median + 0.8, float(section[:, 0].min()) - 0.8, len(stations))
    offsets *= rng.choice([-1, 1], len(stations))
    radii = np.where(rng.random(len(stations)) < 0.8, radius, 0.16)
    drains = np.arange(start, end, 27.0)
    at = np.concatenate([drains + rng.uniform(0, 9, len(drains)) for _ in range(2)])
    edge = np.repeat([section[0, 0] - 0.24, 0.24 - section[1, 0]], len(drains))
    rows = np.concatenate([
        np.stack([stations, offsets, radii], axis=1), np.stack([at, edge, np.full(len(at), -0.21)], axis=1)
    ])  # fmt: skip
    return rows[np.argsort(rows[:, 0], kind="stable")]


def draw_street(seed: int, *, length: float, parameters: StreetParameters | None = None) -> Street:
    """Draw a street, by default a town's, without its objects; it continues for `MARGIN` blocks beyond both ends."""
    kind = parameters or StreetParameters()
    last = int(np.ceil(length / BLOCK)) + MARGIN
    start, end = -MARGIN * BLOCK, last * BLOCK
    alignment = Alignment.drawn(generator(seed, 0), start=start, end=end, bends=kind.bends)
    station = np.arange(len(alignment.table), dtype=np.float64) * STEP + start
    section, shape = _section(generator(seed, 1), kind)
    arms = _arms(generator(seed, 8), alignment, range(-MARGIN, last), kind)
    profile = _profile(generator(seed, 2), station)
    profile[:, 0] *= kind.slopes
    profile[:, 0] -= np.interp(0.0, station, profile[:, 0])
    lots = [
        lot for side in range(2) for lot in draw_lots(generator(seed, 3, side), side, start, end, section, arms, kind)
    ]
    verge, lot_codes = _surfaces(generator(seed, 4), station, lots, profile, kind.bare_soil)
    rng = generator(seed, 5)
    crossings = _crossings(rng, start, end, arms)
    for at, width in crossings:
        dropped = np.clip((np.abs(station - at) - width) / 1.0, 0.1, 1.0)
        profile[:, 1:3] = np.minimum(profile[:, 1:3], dropped[:, None])
    number = 2 * np.pi / rng.uniform(3.5, 12.0, (6, 2)) * rng.choice([-1, 1], (6, 2))
    waves = np.column_stack([number, rng.uniform(0, 6.28, 6), rng.uniform(0.0008, 0.0035, 6)])
    rgb, reflectivity = _ground_materials(generator(seed, 6))
    lids = _lids(rng, start, end, section, float(shape[5]), float(rng.uniform(0.28, 0.36)))
    ground = Ground(start, profile, section, shape, waves, verge, lot_codes, lids, crossings, arms)
    # Drains without a gutter, at side streets, are dropped.
    distance, _ = ground.edge(lids[:, 0], lids[:, 1])
    ground = ground._replace(manholes=lids[(lids[:, 2] > 0) | (np.abs(distance + 0.24) < 0.02)])
    return Street(seed, alignment, ground, tuple(lots), rgb, reflectivity, kind)
