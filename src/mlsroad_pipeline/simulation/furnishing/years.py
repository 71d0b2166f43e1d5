"""Changes of a furnished block in another year: objects gone, moved, leaned, grown and new, other parked cars."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY_NAMES
from mlsroad_pipeline.simulation.furnishing import curbside, parking, premises
from mlsroad_pipeline.simulation.furnishing.placement import Placed, Site
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.street.street import generator

GONE, MOVED, LEANED, GROWN, ADDED = 0.07, 0.05, 0.3, 0.3, 0.07
"""Shares of the lasting objects that are gone, moved along the street, leaned and (of trees) grown; share added."""
DISTANCE = (1.8, 4.5)
"""Least and largest distance of a move, metres."""
LEAN = (0.5, 4.0)
"""Least and largest angle by which the axis of a mast changes, degrees."""
GROWTH = (1.08, 1.25)
"""Least and largest factor on the size of a tree that grew."""

_TREES = ("tree", "palm")
_MASTS = ("light_pole", "traffic_light", "traffic_sign", "station_sign")
_PASSING = ("car", "van", "truck", "person", "bicycle", "motorcycle", "animal")
_FAR = -1e9  # station of footprints of objects that are gone, metres


def change(site: Site) -> None:
    """Change a furnished block as the year of its street says, in place; year 0 changes nothing.

    Objects that stay keep their instance numbers, also those that move.
    """
    year = site.street.parameters.year
    if year == 0:
        return
    site.rng = generator(site.street.seed, 41, site.block, year)
    _remove(site, [row for row, placed in enumerate(site.placed) if _is(placed, _PASSING)])
    # A plate on a lamp shares its place: both change together.
    groups: dict[tuple[float, float], list[int]] = {}
    for row, placed in enumerate(site.placed):
        if _is(placed, (*_TREES, *_MASTS)) and placed.instance and np.isfinite(site.where[row][0]):
            groups.setdefault(site.where[row], []).append(row)
    gone: list[int] = []
    for rows in groups.values():
        drawn, grows = site.rng.random(2)
        if drawn < GONE:
            gone += rows
        elif drawn < GONE + MOVED:
            _move(site, rows)
        elif _is(site.placed[rows[0]], _MASTS) and drawn < GONE + MOVED + LEANED:
            _lean(site, rows)
        elif _is(site.placed[rows[0]], _TREES) and grows < GROWN:
            _grow(site, rows[0])
    _remove(site, gone)
    for _ in range(int(site.rng.poisson(ADDED * len(groups)))):
        label = str(site.rng.choice(["light_pole", "traffic_sign", "traffic_sign", "tree"]))
        curbside.somewhere(site, label, int(site.rng.integers(2)))
    parking.park(site)
    premises.park_on_drives(site)
    for side in range(2):
        curbside.on_pavement(site, side)


def _is(placed: Placed, labels: tuple[str, ...]) -> bool:
    return TAXONOMY_NAMES[placed.label] in labels


def _remove(site: Site, rows: Iterable[int]) -> None:
    """Take objects out of a block; their footprints are free."""
    out = set(rows)
    for row in out:
        if site.rows[row] >= 0:
            site.boxes[site.rows[row], 0] = _FAR
    kept = [row for row in range(len(site.placed)) if row not in out]
    site.placed = [site.placed[row] for row in kept]
    site.where, site.rows = [site.where[row] for row in kept], [site.rows[row] for row in kept]


def _move(site: Site, rows: list[int]) -> None:
    """Move an object, with what hangs on it, along the street to a free place, if there is one."""
    s, left = site.where[rows[0]]
    footprints = [site.rows[row] for row in rows if site.rows[row] >= 0]
    before = site.boxes[footprints].copy()
    way = float(site.rng.choice([-1.0, 1.0]) * site.rng.uniform(*DISTANCE))
    for shift in (way, -way):
        site.boxes[footprints, 0] = _FAR
        new = before + np.array([shift, 0.0, 0.0, 0.0, 0.0])
        if all(site.fits(box, edge=(0.02, 12.0)) for box in new):
            site.boxes[footprints] = new
            base, _ = site.street.on_ground(s + shift, left)
            for row in rows:
                site.placed[row] = _moved(site.placed[row], base - site.street.on_ground(s, left)[0])
                site.where[row] = (s + shift, left)
            return
        site.boxes[footprints] = before


def _moved(placed: Placed, way: NDArray[np.float64]) -> Placed:
    box = placed.box._replace(x=placed.box.x + float(way[0]), y=placed.box.y + float(way[1]))
    return replace(placed, mesh=placed.mesh.moved(way), base=placed.base + way, box=box)


def _lean(site: Site, rows: list[int]) -> None:
    """Lean a mast, with what hangs on it, about its base."""
    turn, angle = float(site.rng.uniform(0, 2 * np.pi)), float(np.radians(site.rng.uniform(*LEAN)))
    rotation = rotation_matrix(turn, angle, 0.0) @ rotation_matrix(-turn, 0.0, 0.0)
    for row in rows:
        placed = site.placed[row]
        vertices = (placed.mesh.vertices - placed.base) @ rotation.T + placed.base
        site.placed[row] = replace(placed, mesh=replace(placed.mesh, vertices=vertices))


def _grow(site: Site, row: int) -> None:
    placed, factor = site.placed[row], float(site.rng.uniform(*GROWTH))
    vertices = (placed.mesh.vertices - placed.base) * factor + placed.base
    box, base = placed.box, placed.base
    box = box._replace(
        length=box.length * factor, width=box.width * factor, height=box.height * factor,
        x=float(base[0] + (box.x - base[0]) * factor), y=float(base[1] + (box.y - base[1]) * factor),
    )  # fmt: skip
    site.placed[row] = replace(placed, mesh=replace(placed.mesh, vertices=vertices), box=box)
