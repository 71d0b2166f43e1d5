"""Growth habits of trees, the outline of one crown, and branching crowns.

Each order of branches grows towards places inside the outline, a greedy form of space colonisation (Runions et al.
2007): places are drawn inside the outline, and each is joined to the nearest node of older branches, where a long way
along the branches counts as distance (Cuntz et al. 2010). Three orders suffice at the resolution of a street survey.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mlsroad_pipeline.simulation.model.materials import bark, foliage
from mlsroad_pipeline.simulation.model.meshes import Mesh, Surface, join
from mlsroad_pipeline.simulation.model.solids import GOLDEN, Floats, bearing, blades, bows, lift, tubes, unit

Range = tuple[float, float]

UNDERGROUND = 0.25  # Depth of stems below ground, so that none floats on a slope, metres
_DETOUR = 0.35  # distance per metre of way along the branches


@dataclass(frozen=True)
class Habit:
    """Growth habit of a kind of tree; individuals are drawn from the range of each pair."""

    height: Range  # Height of the tree, metres
    width: Range  # Diameter of the crown over the height
    clear: Range  # Height below which no limb starts, over the height
    # Exponents a and b of the outline t**a * (1 - t)**b, where t runs from the crown's foot to its top: equal ones give
    # an egg, a larger a puts the widest place higher
    profile: Range
    leader: Range  # Height of the stem's top within the crown, 0 to 1
    rise: Range  # Elevation of limbs at the stem, radians
    # Diameter of the crown over that of the stem at breast height; some 18 to 26 in open-grown street trees
    girth: Range
    limbs: tuple[int, int]  # Number of limbs
    droop: Range  # Drop of the last twigs, metres
    density: Range  # Leaf area per volume of the crown, 1/m; 0.5 to 1.2 in street trees. 0 is a bare tree.
    clump: Range  # Radius of the leaves about the twigs, metres
    stems: tuple[int, int] = (1, 1)  # Number of stems
    shell: float = 2.0  # 0 fills the crown evenly with twigs; larger values crowd them to its outside
    slenderness: float = 0.75  # Width of a leaf over its length


class Outline:
    """Irregular outline of one crown."""

    def __init__(self, rng: np.random.Generator, foot: float, top: float, radius: float, profile: Range) -> None:
        self.foot, self.top = foot, top
        a, b = np.array(profile) * np.exp(rng.normal(0, 0.12, 2))
        t = np.linspace(0.0, 1.0, 41)
        shape = t**a * (1 - t) ** b
        self._t, self._radius = t, radius * shape / shape.max()
        share = np.cumsum(shape**1.5 + 5e-3)
        self._share = (share - share[0]) / (share[-1] - share[0])
        self._lobes = rng.normal(0, [0.10, 0.08, 0.07])
        self._phase, self._twist = rng.uniform(0, 2 * np.pi, 3), rng.normal(0, 3.0, 3)
        self.volume = float(np.pi * (self._radius**2).mean() * (top - foot))

    def place(self, share: Floats, azimuth: Floats, depth: Floats) -> Floats:
        """Return places in the crown, (n, 3) metres about its axis, a little denser where it is narrow.

        `share` is that of the crown below a place; `azimuth` is in radians; `depth` is 0 on the axis, 1 on the outline.
        """
        t = np.interp(share, self._share, self._t)
        wave = np.cos(np.arange(1, 4) * azimuth[:, None] + self._twist * t[:, None] + self._phase) @ self._lobes
        r = np.interp(t, self._t, self._radius) * (1 + wave) * depth
        return np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), self.foot + t * (self.top - self.foot)])


class Colours(NamedTuple):
    """Surfaces of a tree."""

    trunk: Surface  # Stem below the crown
    bark: Surface  # Wood above it
    leaf: Surface  # Average leaf


class Wood(NamedTuple):
    """Branches of one order."""

    paths: Floats  # Points along each, metres
    radii: Floats  # Radius at each point, metres
    way: Floats  # Length of the way from the ground, metres


def grow_tree(rng: np.random.Generator, habit: Habit, colours: Colours, *, faces: int = 5800) -> Mesh:
    """Grow one tree with its stem at the origin and its root `UNDERGROUND` deep.

    `faces` is the number of all faces; those that the wood leaves over are leaves, or twigs of a bare tree.
    """
    height = rng.uniform(*habit.height)
    clear = height * rng.uniform(*habit.clear)
    radius = 0.5 * height * rng.uniform(*habit.width)
    foot = clear + 0.05 * (height - clear)
    outline = Outline(rng, foot, height, radius, habit.profile)
    stem_radius = radius / rng.uniform(*habit.girth)
    stems = _stems(rng, habit, height, clear, stem_radius, radius)
    limbs = _limbs(rng, habit, outline, stems, clear)
    branches = _reach(rng, outline, [limbs], faces // 170, steps=4, shell=habit.shell, thin=0.55)
    n_twigs = faces // (45 if habit.density[1] > 0 else 28)
    steps = 3 if habit.droop[1] > 1 or habit.density[1] == 0 else 2
    twigs = _reach(rng, outline, [limbs, branches], n_twigs, steps=steps, shell=habit.shell, thin=0.5)
    twigs = _hang(rng, twigs, habit)
    lower, upper = _split(stems, clear)
    meshes = [tubes(lower.paths, lower.radii, colours.trunk, sides=9), tubes(upper.paths, upper.radii, colours.bark)]
    meshes += [tubes(limbs.paths, limbs.radii, colours.bark)]
    meshes += [tubes(wood.paths, wood.radii, colours.bark, sides=3) for wood in (branches, twigs)]
    left = faces - sum(len(m.faces) for m in meshes)
    meshes.append(_leaves(rng, habit, outline, twigs, left, colours) if habit.density[1] > 0
                  else _bare_ends(rng, [branches, twigs], left, colours.bark))  # fmt: skip
    return join(meshes)


def _stems(rng: np.random.Generator, habit: Habit, height: float, clear: float, base: float, crown: float) -> Wood:
    """Return stems with buttressed feet; several stems diverge upwards."""
    n = int(rng.integers(habit.stems[0], habit.stems[1] + 1))
    top = clear + rng.uniform(*habit.leader) * (height - clear)
    knee = 0.92 * clear
    z = np.concatenate([[-UNDERGROUND, 0.0, 0.18], np.linspace(max(0.25 * knee, 0.4), knee, 3), [clear],
                        np.linspace(clear, top, 6)[1:]])  # fmt: skip
    up = np.clip(z / top, 0, 1)
    wobble = np.cumsum(rng.normal(0, 0.022 * height / 10, (n, len(z), 2)), axis=1) * np.minimum(up * 4, 1)[:, None]
    lean = rng.normal(0, 0.03, (n, 2)) * height
    azimuth = rng.uniform(0, 2 * np.pi) + np.arange(n) * 2 * np.pi / n
    apart = np.column_stack([np.cos(azimuth), np.sin(azimuth)]) * (n > 1)
    spread = (0.6 * base + rng.uniform(0.12, 0.3) * crown * up**1.3)[:, None] * apart[:, None]
    xy = wobble + lean[:, None] * (up**1.5)[:, None] + spread
    paths = np.concatenate([xy, np.broadcast_to(z[:, None], (n, len(z), 1))], axis=2)
    taper = np.interp(up, [0.0, 0.35, 1.0], [1.0, 0.82, 0.25]) * n**-0.45
    flare = 1 + rng.uniform(0.25, 0.6) * np.exp(-np.maximum(z, 0) / (1.6 * base))
    radii = np.broadcast_to(base * taper * flare, (n, len(z)))
    return Wood(paths, radii, np.broadcast_to(np.maximum(z, 0), (n, len(z))))


def _split(stems: Wood, clear: float) -> tuple[Wood, Wood]:
    """Cut stems at the foot of the crown; the trunk is below."""
    k = int(np.searchsorted(stems.paths[0, :, 2], clear - 1e-9))
    return (Wood(*(a[:, : k + 1] for a in stems)), Wood(*(a[:, k:] for a in stems)))


def _limbs(rng: np.random.Generator, habit: Habit, outline: Outline, stems: Wood, clear: float) -> Wood:
    """Return the limbs that leave the stems and carry the crown, including the leaders' tips."""
    n = int(rng.integers(habit.limbs[0], habit.limbs[1] + 1))
    azimuth = rng.uniform(0, 6.28) + GOLDEN * np.arange(n) + rng.normal(0, 0.25, n)
    share = (np.arange(n) + rng.uniform(0.1, 0.9, n)) / n * 0.93 + 0.05
    ends = outline.place(share, azimuth, rng.uniform(0.55, 0.85, n))
    ends[-1] = outline.place(np.array([0.985]), azimuth[-1:], np.array([0.3]))[0]
    rise = rng.uniform(*habit.rise, n)
    out = np.hypot(ends[:, 0], ends[:, 1])
    z_of = stems.paths[0, :, 2]
    z = np.clip(ends[:, 2] - out * np.tan(rise), clear, z_of[-1] - 0.02 * (z_of[-1] - clear))
    z = np.minimum(z, ends[:, 2] - 0.05)
    z = np.maximum(z, clear)
    # A limb grows from the stem on its own side.
    crowns = stems.paths[:, -1, :2]
    which = ((ends[:, None, :2] - crowns) ** 2).sum(axis=2).argmin(axis=1)
    at = np.interp(z, z_of, np.arange(len(z_of)))
    low = np.minimum(at.astype(np.int64), len(z_of) - 2)
    part = (at - low)[:, None]
    start = (1 - part) * stems.paths[which, low] + part * stems.paths[which, low + 1]
    stem_radius = (1 - part[:, 0]) * stems.radii[which, low] + part[:, 0] * stems.radii[which, low + 1]
    paths = bows(start, bearing(azimuth, rise), ends, 5)
    paths[:, 1:-1] += rng.normal(0, 0.03, (n, 3, 3)) * np.linalg.norm(ends - start, axis=1)[:, None, None]
    length = np.linalg.norm(ends - start, axis=1)
    thick = np.minimum(0.75 * stem_radius, 0.012 * length + 0.35 * stem_radius)
    steps = np.linspace(0, 1, 5)
    return Wood(paths, thick[:, None] * (1 - 0.72 * steps), z[:, None] + length[:, None] * steps)


def _reach(
    rng: np.random.Generator, outline: Outline, older: list[Wood], n: int, *, steps: int, shell: float, thin: float
) -> Wood:
    """Join drawn places to the nearest nodes of older branches."""
    azimuth = rng.uniform(0, 2 * np.pi, n)
    ends = outline.place(rng.random(n), azimuth, rng.random(n) ** (1 / (2 + shell)))
    nodes = np.concatenate([w.paths[:, 1:].reshape(-1, 3) for w in older])
    heading = np.concatenate([np.diff(w.paths, axis=1).reshape(-1, 3) for w in older])
    radii = np.concatenate([w.radii[:, 1:].ravel() for w in older])
    way = np.concatenate([w.way[:, 1:].ravel() for w in older])
    gap = np.sqrt(((ends[:, None] - nodes) ** 2).sum(axis=2))
    nearest = (gap + _DETOUR * way).argmin(axis=1)
    start, length = nodes[nearest], gap[np.arange(n), nearest]
    paths = bows(start, unit(heading[nearest] + rng.normal(0, 0.1, (n, 3))), ends, steps)
    bend = rng.normal(0, 0.05, (n, steps - 2, 3)) * length[:, None, None]
    paths[:, 1:-1] += bend
    s = np.linspace(0, 1, steps)
    thick = np.clip(thin * radii[nearest], 0.004, 0.012 * length + 0.006)
    return Wood(paths, thick[:, None] * (1 - 0.75 * s), way[nearest][:, None] + length[:, None] * s)


def _hang(rng: np.random.Generator, twigs: Wood, habit: Habit) -> Wood:
    """Bend the twigs down, but not to the ground."""
    drop = rng.uniform(*habit.droop) * rng.uniform(0.6, 1.3, len(twigs.paths))
    end = twigs.paths[:, -1]
    drop = np.minimum(drop, np.maximum(end[:, 2] - rng.uniform(1.1, 2.1, len(end)), 0.0))
    paths = twigs.paths.copy()
    paths[:, -1, 2] -= drop
    paths[:, 1:-1, 2] -= 0.12 * drop[:, None]
    return twigs._replace(paths=paths)


def _leaves(rng: np.random.Generator, habit: Habit, outline: Outline, twigs: Wood, n: int, colours: Colours) -> Mesh:
    """Spread leaves along the outer parts of the twigs."""
    which = rng.integers(0, len(twigs.paths), n)
    along = rng.uniform(0.25, 1.05, n)
    steps = twigs.paths.shape[1] - 1
    low = np.minimum((along * steps).astype(np.int64), steps - 1)
    part = (along * steps - low)[:, None]
    a, b = twigs.paths[which, low], twigs.paths[which, low + 1]
    clump = rng.uniform(*habit.clump) * rng.uniform(0.6, 1.3, len(twigs.paths))
    roots = a + part * (b - a) + rng.normal(0, 1, (n, 3)) * 0.6 * clump[which, None]
    roots[:, 2] = np.maximum(roots[:, 2], 0.05)
    area = rng.uniform(*habit.density) * outline.volume / n
    length = float(np.clip(np.sqrt(2 * area / habit.slenderness), 0.06, 0.38))
    hanging = np.array([0.0, 0.0, -rng.uniform(0.1, 0.8)])
    hanging = hanging * (1 + 3 * (habit.droop[0] > 0.5))
    direction = unit(b - a) * 0.5 + rng.normal(0, 0.8, (n, 3)) + hanging
    length_of = length * rng.uniform(0.65, 1.35, n)
    return blades(roots, direction, length_of, habit.slenderness * length_of, colours.leaf, rng)


def _bare_ends(rng: np.random.Generator, older: list[Wood], n: int, bark: Surface) -> Mesh:
    """Return the last, finger-thin twigs of a bare tree."""
    nodes = np.concatenate([w.paths[:, 1:].reshape(-1, 3) for w in older])
    heading = np.concatenate([np.diff(w.paths, axis=1).reshape(-1, 3) for w in older])
    which = rng.integers(0, len(nodes), n)
    direction = unit(heading[which]) + rng.normal(0, 0.55, (n, 3)) + [0, 0, 0.25]
    length = rng.uniform(0.25, 0.9, n)
    return blades(nodes[which], direction, length, rng.uniform(0.006, 0.014, n), bark, rng)


def hedge(rng: np.random.Generator, length: float) -> Mesh:
    """Return a clipped hedge along x, centred, 0.7 to 1.9 m high: leaves around twigs; every face is `hedge`."""
    height, depth = rng.uniform(0.7, 1.9), rng.uniform(0.4, 0.8)
    leaf, wood = foliage(("green", "dark", "light")[int(rng.integers(3))], "hedge", rng), bark("brown", "hedge", rng)
    area = 2 * length * height + length * depth
    n = int(260 * area)
    place = rng.uniform(-1, 1, (n, 3))
    # Leaves are densest near the two faces and the top.
    pick = rng.random(n)
    place[:, 1] = np.where(pick < 0.75, np.sign(place[:, 1]) * (1 - 0.25 * rng.random(n) ** 2), place[:, 1])
    place[:, 2] = np.where(pick > 0.72, 1 - 0.2 * rng.random(n) ** 2, place[:, 2])
    centres = place * [length / 2, depth / 2, height / 2] + [0, 0, height / 2]
    centres[:, 2] += 0.04 * np.sin(centres[:, 0] * 2.1) * (centres[:, 2] / height)
    size = rng.uniform(0.09, 0.15) * rng.uniform(0.7, 1.3, n)
    x = np.arange(-length / 2 + 0.2, length / 2, 0.45)
    foot = np.column_stack([x, 0 * x, np.full_like(x, -UNDERGROUND)])
    top = np.column_stack([x + rng.normal(0, 0.08, len(x)), rng.normal(0, 0.08, len(x)), np.full_like(x, 0.8 * height)])
    stems = tubes(np.stack([foot, top], 1), np.array([0.02, 0.008]), wood, sides=4)
    direction = rng.normal(size=(n, 3))
    return join([lift(blades(centres, direction, size, 0.7 * size, leaf, rng), margin=0.05), stems])


def thicket(rng: np.random.Generator, length: float, *, height: float, depth: float) -> Mesh:
    """Return a run of untrimmed hedge along x, centred: an uneven top and bulging sides with shoots.

    `height` and `depth` are those of its average, metres; runs of one height join. Every face is `hedge`.
    """
    leaf = foliage(("green", "dark", "light", "olive")[int(rng.integers(4))], "hedge", rng)
    wood = bark("brown", "hedge", rng)
    n = int(min(260 * (2 * length * height + length * depth), 9000))
    x = rng.uniform(-length / 2, length / 2, n)
    waves = rng.uniform(0.8, 3.5, (2, 4)) * rng.choice([-1, 1], (2, 4))
    phase = rng.uniform(0, 6.28, (2, 4))
    # Both unevennesses vanish at the ends, so that runs of one height join.
    fade = np.minimum(1.0, (length / 2 - np.abs(x)) / 0.6)
    top = height * (1 + 0.13 * fade * np.sin(x[:, None] * waves[0] + phase[0]).sum(axis=1))
    z = top * rng.random(n) ** 0.8
    bulge = 1 + 0.16 * np.sin(x[:, None] * waves[1] + 2.2 * z[:, None] + phase[1]).sum(axis=1)
    half = 0.5 * depth * bulge * np.sqrt(np.clip(1.15 - (z / top) ** 3, 0.1, 1.0))
    aside = rng.choice([-1.0, 1.0], n) * (1 - 0.5 * rng.random(n) ** 2)
    crest = rng.random(n) < 0.2
    z = np.where(crest, top * (1 - 0.12 * rng.random(n)), z)
    y = np.where(crest, rng.uniform(-1, 1, n), aside) * half
    places = np.column_stack([x, y, z + 0.03]) + rng.normal(0, 0.05, (n, 3))
    shoots = max(int(2.5 * length), 1)
    along = np.linspace(0.0, 1.0, 14)
    foot = places[rng.integers(0, n, shoots)]
    tips = foot + np.column_stack([rng.normal(0, 0.12, shoots), 0.25 * np.sign(foot[:, 1]) * rng.random(shoots),
                                   rng.uniform(0.15, 0.7, shoots)])  # fmt: skip
    grown = (foot[:, None] + along[:, None] * (tips - foot)[:, None]).reshape(-1, 3)
    places = np.concatenate([places, grown + rng.normal(0, 0.025, grown.shape)])
    places[:, 2] = np.maximum(places[:, 2], 0.03)
    size = rng.uniform(0.13, 0.2) * rng.uniform(0.7, 1.4, len(places))
    direction = rng.normal(size=(len(places), 3)) + np.array([0, 0, 0.3])
    at = np.arange(-length / 2 + 0.2, length / 2, 0.6)
    root = np.column_stack([at, 0 * at, np.full_like(at, -UNDERGROUND)])
    head = np.column_stack([at, rng.normal(0, 0.15 * depth, len(at)), np.full_like(at, 0.75 * height)])
    stems = tubes(np.stack([root, head], 1), np.array([0.03, 0.01]), wood, sides=4)
    return join([lift(blades(places, direction, size, 0.7 * size, leaf, rng), margin=0.05), stems])
