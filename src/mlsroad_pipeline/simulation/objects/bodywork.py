"""Vehicles' bodies, lofted along x with arches over the wheels, panes and openings, and the parts that all have.

A body's cross-section has twelve corners: sill, flank, waist, belt line, roof edge and roof on the left, then the same
on the right. The tub is below the belt line, the greenhouse above it; on a bonnet they nearly coincide.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY
from mlsroad_pipeline.simulation.model.materials import SIGN, material, retroreflective
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import box, ellipsoid, tube
from mlsroad_pipeline.simulation.objects.parts import fan, grid_skin, lathe, tinted

Spans = Sequence[tuple[float, float]]
Knots = Sequence[tuple[float, float]]

_ARCH = np.array([-1.001, -1.0, -0.87, -0.5, 0.0, 0.5, 0.87, 1.0, 1.001])
_ENDS = np.array([0.0, 0.07, 0.25, 0.6, 1.0])
_BELT, _ROOF, _UNDER = 3, slice(4, 7), 11  # strips of the skin
_PAINT, _DARK, _GLASS, _COVER = range(4)


@dataclass(frozen=True)
class Body:
    """Lines of a lofted skin; x runs from the rear to the front, metres throughout."""

    half: float  # Half of the width
    clear: float  # Height of the sills above the road
    # top, belt: silhouette from above, and the belt line; the first and the last x are the body's ends
    top: Knots
    belt: Knots
    shoulder: Knots  # Half width of the roof or bonnet over that of the body
    axles: Sequence[float]  # Positions of the wheels
    radius: float  # Of the wheels
    rounding: float = 0.45  # Length over which the ends are drawn in, seen from above
    drawn_in: float = 0.16  # Share of the width by which the ends are drawn in
    # side_panes, top_panes: glass in the sides above the belt line, and over the whole width above: windscreen, rear
    # window
    side_panes: Spans = ()
    top_panes: Spans = ()
    open: Spans = ()  # Stretches without skin above the belt line

    def at(self, knots: Knots, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height or share of a line of the body at some x."""
        table = np.asarray(knots, dtype=np.float64)
        return np.interp(x, table[:, 0], table[:, 1])

    def half_width(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return half of the width at some x; the ends are rounded."""
        rear, front = self.top[0][0], self.top[-1][0]
        near = np.clip(1 - np.minimum(x - rear, front - x) / self.rounding, 0, 1)
        return self.half * (1 - self.drawn_in * near**2.5)

    def stations(self) -> NDArray[np.float64]:
        """Return the x of the cross-sections."""
        rear, front = self.top[0][0], self.top[-1][0]
        lines = [x for knots in (self.top, self.belt, self.shoulder) for x, _ in knots]
        spans = [x for span in (*self.side_panes, *self.top_panes, *self.open) for x in span]
        xs = np.unique(np.concatenate([lines, spans, rear + self.rounding * _ENDS, front - self.rounding * _ENDS]))
        xs = xs[(xs >= rear) & (xs <= front)]
        # Adjacent sections only add faces, except at the upright edges of the arches.
        xs = xs[np.concatenate([[True], np.diff(xs) > 0.015])]
        arches = np.array([axle + 1.14 * self.radius * _ARCH for axle in self.axles]).ravel()
        return np.unique(np.concatenate([xs, arches[(arches > rear) & (arches < front)], [front]]))

    def lower_edge(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the height of the sills, raised by the arches over the wheels."""
        edge = np.full(len(x), self.clear)
        arch = 1.14 * self.radius
        for axle in self.axles:
            inside = np.abs(x - axle) <= arch * 1.0004
            rise = np.sqrt(np.maximum(arch**2 - (x[inside] - axle) ** 2, 0))
            edge[inside] = np.maximum(edge[inside], self.radius + rise)
        return edge


def _within(middle: NDArray[np.float64], spans: Spans) -> NDArray[np.bool_]:
    inside = np.zeros(len(middle), dtype=bool)
    for low, high in spans:
        inside |= (middle > low) & (middle < high)
    return inside


def skin(body: Body, paint: Surface, glass: Surface, under: Surface, *, roof: Surface | None = None) -> Mesh:
    """Return the body's skin, closed at both ends and below, with its panes; some 24 faces per cross-section.

    `roof` is the surface between the outermost top panes, by default that of the rest.
    """
    x = body.stations()
    w, low = body.half_width(x), body.lower_edge(x)
    belt, top = body.at(body.belt, x), body.at(body.top, x)
    low = np.minimum(low, belt - 0.06)
    top = np.maximum(top, belt)
    inner = body.at(body.shoulder, x) * w
    edge = np.minimum(0.06, 0.35 * (top - belt))
    y = np.stack([0.94 * w, w, 0.985 * w, 0.955 * w, inner, 0.55 * inner], axis=1)
    z = np.stack([low, low + 0.4 * (belt - low), belt - 0.22 * (belt - low), belt, top - edge, top], axis=1)
    ring = np.empty((len(x), 13, 3))
    ring[:, :, 0] = x[:, None]
    ring[:, :12, 1] = np.concatenate([y, -y[:, ::-1]], axis=1)
    ring[:, :12, 2] = np.concatenate([z, z[:, ::-1]], axis=1)
    ring[:, 12] = ring[:, 0]
    middle = (x[1:] + x[:-1]) / 2
    which = np.full((len(middle), 12), _PAINT)
    which[:, _UNDER] = _DARK
    if roof is not None and body.top_panes:
        covered = _within(middle, [(min(a for a, _ in body.top_panes), max(b for _, b in body.top_panes))])
        which[covered, _BELT : 11 - _BELT] = _COVER
    side, above, nothing = (_within(middle, s) for s in (body.side_panes, body.top_panes, body.open))
    which[side, _BELT] = which[side, 10 - _BELT] = _GLASS
    which[above, _ROOF] = _GLASS
    which[nothing, _BELT : 11 - _BELT] = -1
    sheet = grid_skin(ring, [paint, under, glass, roof or paint], which)
    return join([sheet, fan(ring[0, 11::-1], paint), fan(ring[-1, :12], paint)])


def rails(body: Body, spans: Spans, thickness: float, paint: Surface) -> list[Mesh]:
    """Return bars along both roof edges over spans of x, such as the pillars of a windscreen."""
    bars = []
    for low, high in spans:
        knots = [x for x, _ in body.top if low < x < high]
        x = np.array([low, *knots, high])
        top, belt = body.at(body.top, x), body.at(body.belt, x)
        y = body.at(body.shoulder, x) * body.half_width(x)
        z = top - np.minimum(0.06, 0.35 * np.maximum(top - belt, 0))
        bars += [tube(np.stack([x, side * y, z], axis=1), thickness, paint, sides=4) for side in (-1, 1)]
    return bars


def pillars(body: Body, xs: Sequence[float], thickness: float, paint: Surface) -> list[Mesh]:
    """Return upright bars from the belt line to the roof's edge on both sides, one pair per x."""
    x = np.asarray(xs, dtype=np.float64)
    w, top, belt = body.half_width(x), body.at(body.top, x), body.at(body.belt, x)
    roof = body.at(body.shoulder, x) * w
    bars = []
    for k in range(len(x)):
        for side in (-1, 1):
            path = [[x[k], side * 0.955 * w[k], belt[k]], [x[k], side * roof[k], top[k] - 0.09]]
            bars.append(tube(path, thickness, paint, sides=3))
    return bars


def wheel(rng: np.random.Generator, radius: float, width: float, tyre: Surface, rim: Surface) -> Mesh:
    """Return a wheel of about 90 faces about the origin, its outer side towards +y; radius and width in metres."""
    hub = rng.uniform(0.56, 0.7)
    tread = [[1.0, -0.45], [1.0, 0.36], [hub, 0.5]]  # open towards the axle, which is out of view
    disc = [[hub, rng.uniform(0.2, 0.45)], [0.2, rng.uniform(0.1, 0.5)], [0.0, 0.35]]
    scale = np.array([radius, width])
    parts = [lathe(np.array(tread) * scale, tyre, sides=16), lathe(np.array(disc) * scale, rim, sides=10)]
    return join(parts).moved([0, 0, 0], roll=-np.pi / 2)


def wheels(rng: np.random.Generator, body: Body, label: str, *, width: float, steered: float = 0.0) -> list[Mesh]:
    """Return the wheels of a body, two per axle, with tyres of a `width`; front wheels turned by `steered` rad."""
    tyre = material("rubber", label, rng)
    one = wheel(rng, body.radius, width, tyre, material("aluminium", label, rng))
    out = body.half - width / 2 - 0.02
    meshes = []
    for x in body.axles:
        turn = steered if x == max(body.axles) else 0.0
        meshes += [one.moved([x, side * out, body.radius], yaw=yaw + turn) for side, yaw in ((1, 0.0), (-1, np.pi))]
    return meshes


def lamps(
    rng: np.random.Generator, body: Body, label: str, *, front: float | None, rear: float | None, upright: bool = False
) -> list[Mesh]:  # fmt: skip
    """Return head lamps, tail lamps with reflectors, and licence plates.

    `front` and `rear` are the heights of the lamps in metres, None for an end without lamps and plate; `upright` tail
    lamps are higher than wide. Plates and reflectors are retro-reflective.
    """
    ends = np.array([body.top[0][0], body.top[-1][0]])
    w = body.half_width(ends)
    clear = tinted((0.6, 0.6, 0.58), label, 0.45, rng)
    red, white = retroreflective(SIGN.red, label, rng), SIGN.white if rng.random() < 0.8 else SIGN.yellow
    wide, tall = rng.uniform(0.13, 0.24), rng.uniform(0.045, 0.09)
    meshes = []
    for side in (-1, 1):
        if front is not None:
            at = [ends[1] - 0.07, side * (w[1] - 0.8 * wide), front]
            meshes.append(ellipsoid(at, [0.11, wide, tall], clear, rings=3, sides=6))
        if rear is not None:
            size = [0.07, 0.14, 0.34] if upright else [0.07, 0.34, 0.13]
            meshes.append(box(size, [ends[0] + 0.015, side * (w[0] - 0.5 * size[1]), rear], red))
    plate = retroreflective(white, label, rng)
    for end, sign, lit in ((ends[0], -1, rear), (ends[1], 1, front)):
        if lit is not None and (sign < 0 or rng.random() < 0.92):
            z = body.clear + rng.uniform(0.18, 0.4)
            meshes.append(box([0.012, rng.uniform(0.34, 0.52), 0.12], [end + sign * 0.012, 0, z], plate))
    return meshes


def mirrors(rng: np.random.Generator, body: Body, x: float, z: float, size: float, paint: Surface) -> list[Mesh]:
    """Return two outside mirrors on their feet; `size` is half their height, metres."""
    out = body.half + rng.uniform(0.04, 0.09)
    radii = [0.55 * size, rng.uniform(0.09, 0.12), size]
    meshes = []
    for side in (-1, 1):
        meshes.append(ellipsoid([x, side * out, z], radii, paint, rings=3, sides=6))
        meshes.append(tube([[x, side * 0.9 * body.half, z - 0.5 * size], [x, side * out, z]], 0.025, paint, sides=4))
    return meshes


def seats(
    label: str, rng: np.random.Generator, xs: Sequence[float], ys: Sequence[float], z: float, tall: float
) -> list[Mesh]:
    """Return seats (cushion, back and head rest) in rows `xs` at places `ys`.

    `z` is the height of the cushions, `tall` that of the backs with head rests above them, metres.
    """
    cover = material("seat", label, rng)
    tilt = rng.uniform(0.1, 0.35)
    one = join([
        box([0.48, 0.48, 0.14], [0.12, 0, -0.02], cover),
        box([0.12, 0.46, 0.72 * tall], [0, 0, 0.36 * tall], cover).moved([-0.1, 0, 0], pitch=-tilt),
        box([0.08, 0.26, 0.2 * tall], [0, 0, 0.88 * tall], cover).moved([-0.1, 0, 0], pitch=-tilt),
    ])  # fmt: skip
    return [one.moved([x, y, z]) for x in xs for y in ys]


def steering_wheel(label: str, at: Sequence[float], rng: np.random.Generator) -> Mesh:
    """Return a steering wheel, tilted towards the seat behind it."""
    dark = Surface(TAXONOMY[label], (0.03, 0.03, 0.03), float(rng.uniform(0.1, 0.3)))
    turn = np.linspace(0, 2 * np.pi, 9)
    ring = np.column_stack([0 * turn, 0.18 * np.cos(turn), 0.18 * np.sin(turn)])
    return tube(ring, 0.018, dark, sides=3).moved(at, pitch=-0.45)
