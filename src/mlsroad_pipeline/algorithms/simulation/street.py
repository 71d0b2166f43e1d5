"""A street drawn from a seed: alignment, profile, cross-section, lots, crossings, and the mesh of its ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.alignment import STEP, Alignment
from mlsroad_pipeline.algorithms.simulation.ground import (
    CURB,
    GRASS,
    LANE_MARKING,
    MANHOLE,
    OTHER_GROUND,
    PARKING,
    ROAD,
    SIDEWALK,
    SOIL,
    Ground,
)  # fmt: skip
from mlsroad_pipeline.algorithms.simulation.meshes import GROUND, Mesh, Surface

BLOCK = 60.0
"""Length of the pieces that a street is populated in, metres."""

MARGIN = 3
"""Blocks of street before the survey's start and after its end."""

HALF_DEPTH = 55.0
"""How far the ground reaches to either side, metres."""


@dataclass(frozen=True)
class Lot:
    """A piece of land beside the street.

    Parameters
    ----------
    side : int
        0 is left, 1 is right.
    start, end : float
        Stations, metres.
    kind : str
        ``"row"`` (facade at the pavement), ``"house"`` (behind a front garden) or ``"open"``.
    boundary : str
        What stands on the property line: ``"fence"``, ``"wall"``, ``"hedge"`` or ``"none"``.
    setback : float
        Distance of the building from the property line, metres.
    driveway : float
        Station of the driveway's middle, NaN where there is none.
    """

    side: int
    start: float
    end: float
    kind: str
    boundary: str
    setback: float
    driveway: float


@dataclass(frozen=True)
class Street:
    """A street.

    Parameters
    ----------
    seed : int
        What it was drawn from.
    alignment : Alignment
        Its centre line.
    ground : Ground
        Its ground.
    lots : tuple of Lot
        The land on both sides.
    ground_rgb : ndarray of shape (256, 3), float64
        Albedo of each ground surface by taxonomy code.
    ground_reflectivity : ndarray of shape (256,), float64
        Its albedo at the scanner's wavelength.
    style : dict of str to float
        Shares of the designs that give the street its character.
    """

    seed: int
    alignment: Alignment
    ground: Ground
    lots: tuple[Lot, ...]
    ground_rgb: NDArray[np.float64]
    ground_reflectivity: NDArray[np.float64]
    style: dict[str, float]

    def kerb_zone(self, side: int) -> float:
        """Return the offset of the line along the curb on which trees, lamps and signs stand."""
        half, _, curb, verge, _ = self.ground.section[side]
        offset = half + curb + (verge / 2 if verge > 0 else 0.45)
        return float(offset if side == 0 else -offset)


def generator(seed: int, *path: int) -> np.random.Generator:
    """Return the generator of one part of a simulation; parts do not share random numbers.

    Parameters
    ----------
    seed : int
        The survey's seed, non-negative.
    *path : int
        Which part it is; other numbers give independent random numbers. None may be below -1024.

    Returns
    -------
    numpy.random.Generator
        A new generator; the same arguments give the same numbers.

    Raises
    ------
    ValueError
        If `seed` or a number of the path is too small.
    """
    return np.random.default_rng([seed, *(p + 1024 for p in path)])


def _section(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    lanes = 1 + int(rng.random() < 0.3)
    lane = rng.uniform(3.1, 3.6)
    parking = [(True, True), (True, False), (False, True)][int(rng.choice(3, p=[0.3, 0.35, 0.35]))]
    verge = [(True, True), (True, False), (False, True)][int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    rows = []
    for side in range(2):
        bay = rng.uniform(2.05, 2.4) if parking[side] else 0.0
        strip = rng.uniform(1.2, 2.4) if verge[side] else 0.0
        pavement = rng.uniform(1.9, 2.8) if verge[side] else rng.uniform(2.6, 3.8)
        rows.append([lanes * lane + bay, bay, rng.uniform(0.13, 0.28), strip, pavement])
    shape = [rng.uniform(0.015, 0.028), rng.uniform(-0.012, 0.012), rng.uniform(0.08, 0.16), lane, lanes]
    return np.array(rows), np.array(shape)


def _lots(rng: np.random.Generator, side: int, start: float, end: float) -> list[Lot]:
    kinds, boundaries = ("row", "house", "open"), ("fence", "wall", "hedge", "none")
    shares, edges = rng.dirichlet([2.5, 2.5, 1.0]), rng.dirichlet([2.0, 2.0, 2.0, 0.7])
    lots, at = [], start
    while at < end:
        kind = str(rng.choice(kinds, p=shares))
        stop = at + rng.uniform(9, 20)
        boundary = "none" if kind == "row" else str(rng.choice(boundaries, p=edges))
        setback = rng.uniform(0.1, 0.5) if kind == "row" else rng.uniform(3.5, 7.5)
        has_driveway = kind != "row" and rng.random() < 0.6
        driveway = rng.uniform(at + 2.2, stop - 2.2) if has_driveway else np.nan
        lots.append(Lot(side, at, stop, kind, boundary, setback, driveway))
        at = stop
    return lots


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
    rng: np.random.Generator, station: NDArray[np.float64], lots: list[Lot], profile: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    verge = np.empty((2, len(station)), dtype=np.uint8)
    lot_codes = np.full((2, len(station)), GRASS, dtype=np.uint8)
    for side in range(2):
        at = 0
        while at < len(station):
            run = int(rng.uniform(8, 30) / STEP)
            verge[side, at : at + run] = GRASS if rng.random() < 0.7 else SOIL
            at += run
    for lot in lots:
        rows = slice(*np.searchsorted(station, [lot.start, lot.end]))
        share = [0.15, 0.1, 0.75] if lot.kind == "row" else [0.62, 0.2, 0.18]
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


def _events(
    rng: np.random.Generator, start: float, end: float, half: float, manhole_radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    stations = np.cumsum(rng.uniform(9, 30, int((end - start) / 9))) + start
    offsets = rng.uniform(-half, half, len(stations))
    radii = np.where(rng.random(len(stations)) < 0.8, manhole_radius, 0.16)
    at = np.cumsum(rng.uniform(70, 160, int((end - start) / 70) + 1)) + start + rng.uniform(0, 60)
    return np.stack([stations, offsets, radii], 1), np.stack([at, rng.uniform(1.4, 2.2, len(at))], 1)


def draw_street(seed: int, *, length: float) -> Street:
    """Draw a street.

    Parameters
    ----------
    seed : int
        Non-negative; another seed is another street.
    length : float
        Surveyed length in metres; the street goes on for `MARGIN` blocks at either end.

    Returns
    -------
    Street
        The street, without what stands on it.
    """
    start, end = -MARGIN * BLOCK, (np.ceil(length / BLOCK) + MARGIN) * BLOCK
    alignment = Alignment.drawn(generator(seed, 0), start=start, end=end)
    station = np.arange(len(alignment.table), dtype=np.float64) * STEP + start
    section, shape = _section(generator(seed, 1))
    profile = _profile(generator(seed, 2), station)
    profile[:, 0] -= np.interp(0.0, station, profile[:, 0])
    lots = [lot for side in range(2) for lot in _lots(generator(seed, 3, side), side, start, end)]
    verge, lot_codes = _surfaces(generator(seed, 4), station, lots, profile)
    rng = generator(seed, 5)
    manholes, crossings = _events(rng, start, end, float(section[:, 0].min()) - 0.5, float(rng.uniform(0.28, 0.36)))
    for at, width in crossings:
        dropped = np.clip((np.abs(station - at) - width) / 1.0, 0.1, 1.0)
        profile[:, 1:3] = np.minimum(profile[:, 1:3], dropped[:, None])
    number = 2 * np.pi / rng.uniform(3.5, 12.0, (6, 2)) * rng.choice([-1, 1], (6, 2))
    waves = np.column_stack([number, rng.uniform(0, 6.28, 6), rng.uniform(0.0008, 0.0035, 6)])
    rgb, reflectivity = _ground_materials(generator(seed, 6))
    ground = Ground(start, profile, section, shape, waves, verge, lot_codes, manholes, crossings)
    names = ("palm", "broadleaf", "bush", "cycas")
    style = dict(zip(names, (float(v) for v in generator(seed, 7).dirichlet([3.0, 2.5, 3.0, 2.0])), strict=True))
    return Street(seed, alignment, ground, tuple(lots), rgb, reflectivity, style)


def ground_mesh(street: Street, block: int) -> Mesh:
    """Return the ground of one block; what covers it is looked up where a pulse meets it.

    Parameters
    ----------
    street : Street
        The street.
    block : int
        Number of the block; block 0 begins at station 0.

    Returns
    -------
    Mesh
        A grid, finer across than along, that follows curbs.
    """
    ground = street.ground
    offsets: list[float] = [0.0]
    for side, sign in ((0, 1.0), (1, -1.0)):
        half, _, curb, verge, pavement = ground.section[side]
        line = half + curb + verge + pavement
        inner = [*np.linspace(0, half, 9)[1:], half + 0.03, half + curb, half + curb + verge]
        outer = [
            line - 0.5,
            line,
            line + 0.5,
            line + 1.0,
            *np.linspace(line + 2.0, line + 20.0, 19),
            *np.linspace(line + 23.0, HALF_DEPTH, 10),
        ]
        offsets += [sign * float(a) for a in inner + outer]
    across = np.unique(np.round(offsets, 9))
    stations = np.arange(block * BLOCK, (block + 1) * BLOCK + STEP / 2, STEP)
    s, left = (grid.ravel() for grid in np.meshgrid(stations, across, indexing="ij"))
    xy, _ = street.alignment.place(s, left)
    vertices = np.column_stack([xy, ground.height(s, left)])
    i, j = (g.ravel() for g in np.meshgrid(np.arange(len(stations) - 1), np.arange(len(across) - 1), indexing="ij"))
    a = i * len(across) + j
    b = a + len(across)
    faces = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    return Mesh(vertices, faces, Surface(0, (0.2, 0.2, 0.2), 0.3, GROUND).rows(len(faces)))
