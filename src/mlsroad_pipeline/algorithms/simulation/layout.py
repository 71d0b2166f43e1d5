"""What stands in a street, and where: one block at a time, each drawn from its own seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.classes import TAXONOMY
from mlsroad_pipeline.algorithms.simulation import buildings, furniture, poles, vegetation, vehicles
from mlsroad_pipeline.algorithms.simulation.meshes import Mesh, rotation_matrix
from mlsroad_pipeline.algorithms.simulation.street import BLOCK, MARGIN, Lot, Street, generator

INSTANCES_PER_BLOCK = 2048
"""Instance numbers reserved for each block, so that they are unique along a street of any length."""

Placement = tuple[Callable[[np.random.Generator], Mesh], str, float]

# What may stand along the curb: design, class, half of the length that it keeps free for itself (m).
_KERB: dict[str, Placement] = {
    "palm": (vegetation.palm, "palm", 0.7), "broadleaf": (vegetation.broadleaf_tree, "tree", 0.8),
    "cycas": (vegetation.cycas, "cycas", 0.8), "bush": (vegetation.brushwood, "brushwood", 1.1),
    "sign": (poles.traffic_sign, "traffic_sign", 0.4), "bin": (furniture.waste_bin, "bin", 0.5),
    "bench": (furniture.bench, "bench", 1.1), "hydrant": (furniture.hydrant, "hydrant", 0.4),
    "mail_box": (furniture.mail_box, "mail_box", 0.4),
}  # fmt: skip
_REQUIRED = (
    ("palm", "sign", "bush", "cycas", "bin", "bollards", "broadleaf"),
    ("broadleaf", "sign", "cycas", "bench", "bush", "palm", "rack"),
)


@dataclass(frozen=True)
class Placed:
    """An object where it stands.

    Parameters
    ----------
    label : int
        Taxonomy code of the whole; faces of its mesh may have finer ones.
    instance : int
        Its number, unique along the street; 0 for facades, fences, walls and hedges.
    mesh : Mesh
        Faces in street-local coordinates (m).
    base : ndarray of shape (3,), float64
        Where it meets the ground (m).
    """

    label: int
    instance: int
    mesh: Mesh
    base: NDArray[np.float64]


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
    filler = _Filler(street, block)
    filler.lamps()
    filler.utility_line()
    filler.crossings()
    filler.bus_stop()
    for side in range(2):
        filler.parked(side)
        filler.kerb(side)
        filler.pavement(side)
    for lot in street.lots:
        if block * BLOCK <= (lot.start + lot.end) / 2 < (block + 1) * BLOCK:
            filler.lot(lot)
    return filler.placed


class _Filler:
    """Puts objects into one block and remembers which stretches of curb are taken."""

    def __init__(self, street: Street, block: int) -> None:
        self.street, self.block = street, block
        self.start, self.end = block * BLOCK, (block + 1) * BLOCK
        self.placed: list[Placed] = []
        self.rng = generator(street.seed, 10, block)
        self.taken: list[list[tuple[float, float]]] = [[], []]
        self.zebras = [(at, w) for at, w in street.ground.crossings if self.start - 20 < at < self.end + 20]
        lots = [lot for lot in street.lots if lot.end > self.start - 20 and lot.start < self.end + 20]
        self.driveways = [[t.driveway for t in lots if t.side == k and np.isfinite(t.driveway)] for k in range(2)]
        for side in range(2):
            self.taken[side] += [(at - half - 0.6, at + half + 0.6) for at, half in self.zebras]
            self.taken[side] += [(at - 2.0, at + 2.0) for at in self.driveways[side]]

    def put(
        self, label: str, mesh: Mesh, station: float, offset: float, *, turn: float = 0.0, tilt: bool = False,
        numbered: bool = True,
    ) -> None:  # fmt: skip
        """Place a mesh whose -y looks at the road; `tilt` lays it on the slope along the street."""
        ground = self.street.ground
        xy, heading = self.street.alignment.place([station], [offset])
        z = float(ground.height([station], [offset])[0])
        yaw = float(heading[0]) + (0.0 if offset >= 0 else np.pi) + turn
        pitch = 0.0
        if tilt:
            ahead, behind = ground.height([station + 1.0, station - 1.0], [offset, offset])
            pitch = -float(np.arctan((ahead - behind) / 2.0) * np.cos(yaw - heading[0]))
        base = np.array([xy[0, 0], xy[0, 1], z])
        first = (self.block + MARGIN) * INSTANCES_PER_BLOCK + 1
        instance = first + sum(p.instance > 0 for p in self.placed) if numbered else 0
        self.placed.append(Placed(TAXONOMY[label], instance, mesh.moved(base, yaw=yaw, pitch=pitch), base))

    def reserve(self, side: int, half: float, *, tries: int = 14) -> float | None:
        """Return a free station on a curb and take it, or None where none was found."""
        for _ in range(tries):
            at = float(self.rng.uniform(self.start, self.end))
            if all(at + half < low or at - half > high for low, high in self.taken[side]):
                self.taken[side].append((at - half, at + half))
                return at
        return None

    def lamps(self) -> None:
        """Place street lamps at their spacing, some with a sign; they come before trees and may stand in crowns."""
        rng = generator(self.street.seed, 11)
        spacing, both = rng.uniform(22, 34), rng.random() < 0.4
        designs = rng.choice(poles.LAMP_DESIGNS, 2, replace=False)
        for k in range(int(np.ceil(self.start / spacing)), int(np.ceil(self.end / spacing))):
            for side in (0, 1) if both else (k % 2,):
                at = (k + 0.12 * float(self.rng.uniform(-1, 1))) * spacing
                offset = self.street.kerb_zone(side)
                lamp = poles.light_pole(self.rng, str(designs[0] if self.rng.random() < 0.75 else designs[1]))
                self.put("light_pole", lamp, at, offset, turn=float(self.rng.normal(0, 0.03)))
                self.taken[side].append((at - 0.4, at + 0.4))
                if self.rng.random() < 0.3:
                    sheet, half = poles.sign_plate(self.rng)
                    lifted = sheet.moved([0, -0.18, float(self.rng.uniform(2.4, 3.0)) + half])
                    turn = np.pi / 2 + float(self.rng.normal(0, 0.1))
                    self.put("traffic_sign", lifted, at, offset, turn=turn)

    def utility_line(self) -> None:
        """Place utility poles along one property line, with wires from each to the next one."""
        rng = generator(self.street.seed, 12)
        side, spacing = int(rng.integers(2)), rng.uniform(29, 40)
        offset = (self.street.ground.property_line(side) - 0.35) * (1 if side == 0 else -1)
        sag, radius = rng.uniform(0.3, 0.9), rng.uniform(0.008, 0.014)
        for k in range(int(np.ceil(self.start / spacing)), int(np.ceil(self.end / spacing))):
            pole, hang = self._hung_pole(k)
            self.put("utility_pole", pole, k * spacing, offset)
            here = self.placed[-1].base
            _, ahead_hang = self._hung_pole(k + 1)
            xy, heading = self.street.alignment.place([k * spacing, (k + 1) * spacing], [offset, offset])
            yaw = heading + (0.0 if side == 0 else np.pi)
            z = self.street.ground.height([(k + 1) * spacing], [offset])
            ahead = np.array([xy[1, 0], xy[1, 1], z[0]])
            starts = hang @ rotation_matrix(float(yaw[0]), 0, 0).T + here
            ends = ahead_hang @ rotation_matrix(float(yaw[1]), 0, 0).T + ahead
            for a, b in zip(starts, ends, strict=True):
                span = poles.wire(a - here, b - here, sag * float(self.rng.uniform(0.8, 1.2)), radius, self.rng)
                moved = Mesh(span.vertices + here, span.faces, span.attributes)
                first = (self.block + MARGIN) * INSTANCES_PER_BLOCK + 1
                number = first + sum(p.instance > 0 for p in self.placed)
                self.placed.append(Placed(TAXONOMY["wire"], number, moved, a))

    def _hung_pole(self, k: int) -> tuple[Mesh, NDArray[np.float64]]:
        return poles.utility_pole(generator(self.street.seed, 13, k))

    def crossings(self) -> None:
        """Place traffic lights or signs at zebra crossings."""
        for at, half in self.zebras:
            if not self.start <= at < self.end:
                continue
            lights = self.rng.random() < 0.6
            for side in range(2):
                # Right-hand traffic comes to the crossing from below on the right, from above on the left.
                station = float(at) + (half + 0.9) * (1 if side == 0 else -1)
                mesh = poles.traffic_light(self.rng) if lights else poles.traffic_sign(self.rng)
                label = "traffic_light" if lights else "traffic_sign"
                self.put(label, mesh, station, self.street.kerb_zone(side), turn=np.pi / 2)
                self.taken[side].append((station - 0.5, station + 0.5))

    def bus_stop(self) -> None:
        """Place a bus stop in every second block."""
        if (self.block + self.street.seed) % 2:
            return
        side = (self.block // 2) % 2
        at = self.reserve(side, 3.0, tries=40)
        if at is None:
            return
        sign = 1 if side == 0 else -1
        half, _, curb, verge, pavement = self.street.ground.section[side]
        offset = sign * float(half + curb + verge + pavement - 0.95)
        self.put("bus_shelter", furniture.bus_shelter(self.rng), at, offset)
        station = furniture.bus_stop_sign(self.rng)
        self.put("station_sign", station, at + 2.6, self.street.kerb_zone(side), turn=float(self.rng.normal(0, 0.1)))

    def parked(self, side: int) -> None:
        """Fill the parking strip, if there is one, leaving bays, driveways and crossings free."""
        half, bay = self.street.ground.section[side, :2]
        if bay == 0:
            return
        offset = (half - bay / 2) * (1 if side == 0 else -1)
        blocked = [(at - w - 5.0, at + w + 5.0) for at, w in self.zebras]
        blocked += [(at - 1.9, at + 1.9) for at in self.driveways[side]]
        at = self.start + float(self.rng.uniform(2.0, 4.0))
        while at < self.end - 3.2:
            length = 5.8 if self.rng.random() < 0.85 else 6.8
            free = not any(at - 2.7 < high and at + 2.7 > low for low, high in blocked)
            if free and self.rng.random() < 0.72:
                is_van = length > 6 or self.rng.random() < 0.1
                mesh = vehicles.van(self.rng) if is_van else vehicles.car(self.rng)
                back = np.pi if self.rng.random() < 0.12 else 0.0
                # Right-hand traffic: on either side local x points against the lane.
                turn = np.pi + back + float(self.rng.normal(0, 0.02))
                lateral = offset + float(self.rng.normal(0, 0.08))
                self.put("van" if is_van else "car", mesh, at, lateral, turn=turn, tilt=True)
            at += length + float(self.rng.uniform(-0.2, 0.3))

    def kerb(self, side: int) -> None:
        """Fill the curb's strip: what every street has, then plants and things by the street's style."""
        required = list(_REQUIRED[(side + self.block) % 2])
        style = self.street.style
        extra = self.rng.choice(list(style), int(self.rng.integers(4, 10)), p=list(style.values()))
        clutter = self.rng.choice(["sign", "bin", "hydrant", "mail_box", "bollards", "rack", "bench"], 3)
        for name in [*required, *(str(n) for n in extra), *(str(n) for n in clutter)]:
            half = {"bollards": 3.0, "rack": 2.1}.get(name) or _KERB[name][2]
            at = self.reserve(side, half)
            if at is not None:
                self._kerb_item(name, at, side)

    def _kerb_item(self, name: str, at: float, side: int) -> None:
        offset = self.street.kerb_zone(side) + float(self.rng.normal(0, 0.08))
        if name == "bollards":
            for post in furniture.bollards(self.rng):
                x = float(post.vertices[:, 0].mean())
                self.put("bollard", post.moved([-x, 0, 0]), at + x, offset)
            return
        if name == "rack":
            hoops, bikes = furniture.cycle_rack(self.rng)
            self.put("other_object", hoops, at, offset, tilt=True)
            for bike in bikes:
                self.put("bicycle", bike, at, offset, tilt=True)
            return
        design, label, _ = _KERB[name]
        free = name in ("palm", "broadleaf", "cycas", "bush", "hydrant")
        turn = float(self.rng.uniform(0, 6.28)) if free else float(self.rng.normal(0, 0.06))
        if name == "sign":
            turn += np.pi / 2
        self.put(label, design(self.rng), at, offset, turn=turn)

    def pavement(self, side: int) -> None:
        """Place people who stand, and bins at the property line."""
        line = self.street.ground.property_line(side)
        sign = 1 if side == 0 else -1
        for _ in range(int(self.rng.poisson(1.6))):
            at = float(self.rng.uniform(self.start, self.end))
            offset = sign * float(line - self.rng.uniform(0.5, 1.5))
            self.put("person", vehicles.person(self.rng), at, offset, turn=float(self.rng.uniform(0, 6.28)))
        for _ in range(int(self.rng.poisson(1.5))):
            at = float(self.rng.uniform(self.start, self.end))
            self.put("bin", furniture.waste_bin(self.rng), at, sign * (line - 0.4), turn=float(self.rng.normal(0, 0.2)))

    def lot(self, lot: Lot) -> None:
        """Build on a lot: the house, what stands on the property line, and the garden."""
        rng, sign = self.rng, 1 if lot.side == 0 else -1
        line = self.street.ground.property_line(lot.side)
        middle, length = (lot.start + lot.end) / 2, lot.end - lot.start
        if lot.kind != "open":
            gap = 0.0 if lot.kind == "row" else float(rng.uniform(1.0, 3.0))
            house = buildings.building(rng, max(length - gap, 4.0))
            self.put("building", house, middle, sign * (line + lot.setback), numbered=False)
            if lot.kind == "row" and rng.random() < 0.35:
                board = buildings.shop_sign(rng, 0.5 * length)
                self.put("building", board, middle, sign * (line + lot.setback), numbered=False)
        self._boundary(lot, sign * (line + 0.25))
        deep = lot.setback - 1.2 if lot.kind == "house" else 14.0 if lot.kind == "open" else 0.0
        if deep > 1.0:
            for name in rng.choice(["broadleaf", "bush", "palm", "bush"], int(rng.integers(1, 5 if deep < 8 else 8))):
                at, offset = rng.uniform(lot.start + 0.8, lot.end - 0.8), line + 1.0 + rng.uniform(0.2, deep)
                design, label, _ = _KERB[str(name)]
                self.put(label, design(rng), float(at), sign * float(offset), turn=float(rng.uniform(0, 6.28)))

    def _boundary(self, lot: Lot, offset: float) -> None:
        if lot.boundary == "none":
            return
        gate = (lot.driveway - 1.6, lot.driveway + 1.6) if np.isfinite(lot.driveway) else (lot.end, lot.end)
        design_state = int(self.rng.integers(2**31))
        for low, high in ((lot.start, gate[0]), (gate[1], lot.end)):
            pieces = max(round((high - low) / 4.0), 1)
            edges = np.linspace(low, high, pieces + 1)
            if high - low < 0.6:
                continue
            for a, b in pairwise(edges):
                # One design along a lot: every run is drawn from the same state.
                rng = np.random.default_rng(design_state)
                make = {"fence": buildings.fence, "wall": buildings.wall, "hedge": vegetation.hedge}[lot.boundary]
                mesh = make(rng, float(b - a))
                self.put(lot.boundary, mesh, float(a + b) / 2, offset, tilt=True, numbered=False)
