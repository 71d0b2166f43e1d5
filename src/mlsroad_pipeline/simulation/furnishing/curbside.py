"""Objects between the curb and the property line: lamps, rows of trees, signs, bus stops, furniture, people."""

import math

import numpy as np

from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.overhead import dry_station
from mlsroad_pipeline.simulation.furnishing.parking import is_left_out
from mlsroad_pipeline.simulation.furnishing.placement import Placed, Site
from mlsroad_pipeline.simulation.objects.people import WALKERS, conversation
from mlsroad_pipeline.simulation.objects.traffic_signs import sign_plate
from mlsroad_pipeline.simulation.street.street import generator

_FREE = ("palm", "tree", "cycas", "brushwood", "hydrant")  # of any heading
_EVERY_BLOCK = (
    ("palm", "traffic_sign", "brushwood", "cycas", "bin", "bollard", "tree"),
    ("tree", "traffic_sign", "cycas", "bench", "brushwood", "palm", "other_object", "bicycle"),
)
"""Classes on one side of each block and on the other, unless the parameters exclude them."""

_CLUTTER = ("bin", "hydrant", "mail_box", "bollard", "other_object", "bench", "parking_meter", "bicycle", "animal",
            "motorcycle")  # fmt: skip
_GROUPS = 0.25  # share of groups among standing people
_TRIES = 12  # places tried for each object along the curb


def _factor(site: Site, label: str) -> float:
    """Return the street's factor on the usual number of a class."""
    parameters = site.parameters
    named = {"tree": parameters.trees, "palm": parameters.palms, "cycas": parameters.cycas, "person": parameters.people,
             "brushwood": parameters.shrubs, "traffic_sign": parameters.signs}  # fmt: skip
    return named.get(label, parameters.clutter)


def _strip(site: Site, side: int, label: str) -> float:
    """Return the offset of a place on the strip along the curb, or on a wide verge."""
    half, _, curb, verge, _ = (float(v) for v in site.street.ground.section[side])
    way = 1.0 if side == 0 else -1.0
    if label in _FREE and verge > 2.6:
        # Low plants are near the lane, the others anywhere on the strip.
        far = min(verge - 0.7, 1.8) if label == "cycas" else verge - 0.7
        return way * (half + curb + float(site.rng.uniform(0.9, far)))
    return site.street.kerb_zone(side) + float(site.rng.normal(0, 0.06))


def _turned(site: Site, label: str, left: float) -> float:
    if label in _FREE:
        return float(site.rng.uniform(0, 6.28))
    if label in ("traffic_sign", "station_sign"):
        return site.facing_traffic(left) + float(site.rng.normal(0, 0.06))
    if label in ("bicycle", "motorcycle"):
        return float(site.rng.choice([0.0, np.pi])) + float(site.rng.normal(0, 0.2))
    return site.toward_road(left) + float(site.rng.normal(0, 0.06))


def somewhere(site: Site, label: str, side: int) -> Placed | None:
    """Place an object of a class at a free place along one curb (side 0 is left), or return None after all tries."""
    chosen = catalogue.choose(label, site.rng)
    mesh = chosen.build(site.rng)
    width = float(site.street.ground.section[side, 2:].sum())
    for _ in range(_TRIES):
        s, left = float(site.rng.uniform(site.start + 0.5, site.end - 0.5)), _strip(site, side, label)
        yaw = _turned(site, label, left)
        if site.street.ground.edge([s], [left])[0][0] < 0.05:
            continue
        # Wide shrubs may overhang the curb, but not the lane.
        least = 0.05 if label not in _FREE else -0.25
        placed = site.try_add(chosen, s, left, yaw, edge=(least, width + 0.8), tilt=label == "bicycle", mesh=mesh)
        if placed is not None:
            return placed
    return None


def lamps(site: Site) -> None:
    """Place street lamps at their spacing; on a median they have two arms."""
    street = site.street
    rng = generator(street.seed, 11)
    spacing = street.parameters.lamp_spacing or float(rng.uniform(25, 40))
    both, on_median = rng.random() < 0.4, street.ground.shape[5] > 0
    names = [catalogue.choose("light_pole", rng).name for _ in range(2)]
    if on_median:
        names = 2 * ["double_arm_lamp"]
    for k in range(int(np.ceil(site.start / spacing)), int(np.ceil(site.end / spacing))):
        sides = (0, 1) if both else (k % 2,)
        for left in [0.0] if on_median else [street.kerb_zone(side) for side in sides]:
            name = names[0] if site.rng.random() < 0.8 else names[1]
            design = catalogue.choose("light_pole", site.rng, name)
            mesh = design.build(site.rng)
            yaw = site.toward_road(left) + float(site.rng.normal(0, 0.03))
            at = k * spacing + float(site.rng.uniform(-1, 1))
            for shift in (0.0, 1.5, -1.5, 3.0, -3.0, 5.0, -5.0):
                s = dry_station(street, at + shift, left)
                if site.fits(site.footprint(mesh, s, left, yaw), edge=(0.02, 12.0)):
                    lamp = site.add(design, mesh, s, left, yaw)
                    _plate_on(site, lamp, s, left)
                    break


def _plate_on(site: Site, lamp: Placed, s: float, left: float) -> None:
    """Hang a traffic sign on some lamps whose design has no sign."""
    if "sign" in lamp.design or site.rng.random() > 0.3 * site.parameters.signs:
        return
    (sheet, half), name = sign_plate(site.rng), "plate_on_lamp"
    lifted = sheet.moved([0.18, 0.0, float(site.rng.uniform(2.2, 2.8)) + half])
    yaw = site.facing_traffic(left) + float(site.rng.normal(0, 0.1))
    site.add((name, "traffic_sign"), lifted, s, left, yaw, solid=False)


def bus_stops(site: Site) -> None:
    """Place bus stops, by default one in every second block, on alternate sides."""
    number, often = site.block + site.street.seed, site.parameters.stations / 2
    for k in range(math.ceil((number + 1) * often) - math.ceil(number * often)):
        _bus_stop(site, (site.block // 2 + k) % 2)


def _bus_stop(site: Site, side: int) -> None:
    """Place a shelter at the back of the pavement and its sign at the curb."""
    way, width = (1.0 if side == 0 else -1.0), float(site.street.ground.section[side, 2:].sum())
    design = catalogue.choose("bus_shelter", site.rng)
    mesh = design.build(site.rng)
    deep = -float(mesh.vertices[:, 0].min())
    left = way * (site.street.ground.property_line(side) - deep - 0.15)
    for _ in range(30):
        s = float(site.rng.uniform(site.start + 3, site.end - 3))
        yaw = site.toward_road(left)
        if site.fits(site.footprint(mesh, s, left, yaw), edge=(0.4, width + 0.3)):
            site.add(design, mesh, s, left, yaw)
            zone = site.street.kerb_zone(side)
            site.try_add(catalogue.choose("station_sign", site.rng), s - way * 3.2, zone, site.facing_traffic(zone),
                         edge=(0.05, 12.0))  # fmt: skip
            return


def tree_rows(site: Site) -> None:
    """Plant rows of one species along the curb at the spacing of that side, with gaps."""
    parameters = site.parameters
    weights = np.array([3.0 * parameters.palms, 2.5 * parameters.trees])
    if weights.sum() == 0:
        return
    for side in range(2):
        rng = generator(site.street.seed, 15, side)
        planted = rng.random() < 0.65
        spacing, kept = float(rng.uniform(6.5, 12)), float(rng.uniform(0.6, 0.95))
        label = str(rng.choice(["palm", "tree"], p=weights / weights.sum()))
        design = catalogue.choose(label, rng)
        if not planted:
            continue
        width = float(site.street.ground.section[side, 2:].sum())
        for k in range(int(np.ceil(site.start / spacing)), int(np.ceil(site.end / spacing))):
            if site.rng.random() < kept * min(_factor(site, label), 1.0):
                other = design if site.rng.random() < 0.9 else catalogue.choose(label, site.rng)
                s, left = k * spacing + float(site.rng.normal(0, 0.15)), site.street.kerb_zone(side)
                site.try_add(other, s, left, float(site.rng.uniform(0, 6.28)), edge=(0.05, width))


def furnish(site: Site) -> None:
    """Place the objects of every street, then plants and furniture by the parameters, then people."""
    rng, parameters = site.rng, site.parameters
    for side in range(2):
        labels = [label for label in _EVERY_BLOCK[(side + site.block) % 2] if _factor(site, label) > 0]
        for label, mean in (("brushwood", 2.0), ("cycas", 1.0), ("palm", 1.0), ("tree", 0.8), ("traffic_sign", 1.2)):
            labels += [label] * int(rng.poisson(mean * _factor(site, label)))
        labels += [str(label) for label in rng.choice(_CLUTTER, int(rng.poisson(3.0 * parameters.clutter)))]
        for label in labels:
            if not (label in ("bicycle", "motorcycle") and is_left_out(rng, parameters.two_wheelers)):
                placed = somewhere(site, label, side)
                if label == "bollard" and placed is not None:
                    _row_of(site, placed)
        on_pavement(site, side)


def _row_of(site: Site, first: Placed) -> None:
    """Place more bollards of the same design in a row."""
    s, left = site.where[-1]
    design = catalogue.choose("bollard", site.rng, first.design)
    for k in range(1, int(site.rng.integers(3, 6))):
        site.try_add(design, s + 1.3 * k, left, 0.0, edge=(0.02, 12.0))


def on_pavement(site: Site, side: int) -> None:
    """Place standing people, and bins at the property line."""
    line, way = site.street.ground.property_line(side), 1.0 if side == 0 else -1.0
    pavement = float(site.street.ground.section[side, 4])
    width = float(site.street.ground.section[side, 2:].sum())
    for label, mean in (("person", 1.6 * site.parameters.people), ("bin", 1.2 * site.parameters.clutter)):
        for _ in range(int(site.rng.poisson(mean))):
            back = site.rng.uniform(0.35, 0.75) if label == "bin" else site.rng.uniform(0.4, max(pavement - 0.4, 0.5))
            left = way * (line - float(back))
            yaw = site.toward_road(left) if label == "bin" else float(site.rng.uniform(0, 6.28))
            s = float(site.rng.uniform(site.start + 1, site.end - 1))
            if label == "person" and site.rng.random() < _GROUPS:
                _group(site, s, left, (0.1, width + 0.05))
                continue
            design = catalogue.choose(label, site.rng)
            if design.name not in WALKERS:
                site.try_add(design, s, left, yaw, edge=(0.1, width + 0.05))


def _group(site: Site, s: float, left: float, edge: tuple[float, float]) -> None:
    """Place people who stand in a ring and talk, if all of them fit."""
    ring = []
    for body in conversation(site.rng):
        x, y = (float(v) for v in body.vertices[:, :2].mean(axis=0))
        # They face each other.
        yaw = float(np.arctan2(-y, -x))
        ring.append((body.moved([-x, -y, 0.0]).moved([0.0, 0.0, 0.0], yaw=-yaw), s + x, left + y, yaw))
    if all(site.fits(site.footprint(*who), edge=edge) for who in ring):
        design = catalogue.choose("person", site.rng, "talking_person")
        for who in ring:
            site.add(design, *who)


def plant_median(site: Site) -> None:
    """Plant palms, trees, cycas and shrubs on the median."""
    median, rng, parameters = float(site.street.ground.shape[5]), site.rng, site.parameters
    if median == 0:
        return
    tall = float(generator(site.street.seed, 16).uniform(6, 9))
    weights = np.array([3.0 * parameters.palms, 2.5 * parameters.trees])
    for k in range(int(np.ceil(site.start / tall)), int(np.ceil(site.end / tall))):
        if weights.sum() > 0 and rng.random() < 0.8 * min(parameters.palms + parameters.trees, 1.0):
            label = str(rng.choice(["palm", "tree"], p=weights / weights.sum()))
            _on_median(site, label, k * tall, 0.0, median)
    for label, mean in (("brushwood", 4.0 * parameters.shrubs), ("cycas", 5.0 * parameters.cycas)):
        for _ in range(int(rng.poisson(mean))):
            s = float(rng.uniform(site.start + 1, site.end - 1))
            off = max(median - 1.2, 0.0) * (
                rng.uniform(-1, 1) if label == "brushwood" else rng.choice([-1.0, 0.0, 1.0])
            )
            _on_median(site, label, s, float(off), median)


def _on_median(site: Site, label: str, s: float, left: float, median: float) -> None:
    design = catalogue.choose(label, site.rng)
    _, arm = site.street.ground.edge([s], [left])
    if arm[0] == -2:
        site.try_add(design, s, left, float(site.rng.uniform(0, 6.28)), edge=(-0.2, median + 0.1))
