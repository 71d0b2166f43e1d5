"""Hard cases: objects that touch, contain or occlude each other."""

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES
from mlsroad_pipeline.simulation.furnishing import catalogue
from mlsroad_pipeline.simulation.furnishing.placement import Site, overlaps

_PARTNERS: dict[str, tuple[str, ...]] = {
    "tree": ("pole_in_crown", "behind_tree"),
    "palm": ("pole_in_crown", "behind_tree"),
    "brushwood": ("shrub_row",),
    "cycas": ("shrub_row",),
    "light_pole": ("bin_at_pole", "shrub_at_pole"),
    "utility_pole": ("bin_at_pole", "shrub_at_pole"),
    "traffic_sign": ("bin_at_pole", "shrub_at_pole"),
    "car": ("plant_at_car",),
    "van": ("plant_at_car",),
}
"""Hard cases for objects of each class."""


def add(site: Site) -> None:
    """Place confusable neighbours beside a share of the objects along the curb of a furnished block."""
    if site.parameters.hard_cases == 0:
        return
    for number in range(len(site.placed)):
        placed, (s, left) = site.placed[number], site.where[number]
        cases = _PARTNERS.get(TAXONOMY_NAMES[placed.label], ())
        outer = site.street.ground.property_line(0 if left >= 0 else 1) + 0.3
        if not cases or placed.instance == 0 or site.rows[number] < 0 or abs(left) > outer:
            continue
        if site.rng.random() < site.parameters.hard_cases:
            before = len(site.placed)
            for case in 2 * list(site.rng.permutation(cases)):
                _partner(site, number, s, left, str(case))
                if len(site.placed) > before:
                    break


def _partner(site: Site, number: int, s: float, left: float, case: str) -> None:
    placed = site.placed[number]
    rng, way = site.rng, 1.0 if left >= 0 else -1.0
    beside = float(rng.choice([-1.0, 1.0]))
    if case == "pole_in_crown":
        label = "light_pole" if rng.random() < 0.4 else "traffic_sign"
        yaw = site.toward_road(left) if label == "light_pole" else site.facing_traffic(left)
        _beside(site, label, s + beside * float(rng.uniform(0.55, 1.2)), left, yaw, case, number, touch=False)
    elif case == "behind_tree":
        label = str(rng.choice(["person", "bin", "traffic_sign"]))
        yaw = site.toward_road(left)
        _beside(site, label, s, left + way * float(rng.uniform(0.6, 1.3)), yaw, case, number, touch=False)
    elif case == "shrub_row":
        label, half = TAXONOMY_NAMES[placed.label], max(placed.box.length, placed.box.width) / 2
        for k in range(1, int(rng.integers(2, 5))):
            _beside(
                site, label, s + beside * k * 1.3 * half, left, float(rng.uniform(0, 6.28)), case, number, touch=True
            )
    elif case == "bin_at_pole":
        yaw = site.toward_road(left)
        mesh_half = float(rng.uniform(0.28, 0.4))
        _beside(site, "bin", s + beside * mesh_half, left, yaw, case, number, touch=True)
    elif case == "shrub_at_pole":
        at = s + beside * float(rng.uniform(0.1, 0.5))
        _beside(site, "brushwood", at, left, float(rng.uniform(0, 6.28)), case, number, touch=True)
    else:
        half, curb = (float(v) for v in site.street.ground.section[0 if left >= 0 else 1, [0, 2]])
        off = way * (half + curb + float(rng.uniform(0.3, 0.6)))
        _beside(site, "brushwood", s + float(rng.uniform(-1.5, 1.5)), off, float(rng.uniform(0, 6.28)), case, number,
                touch=True)  # fmt: skip


def _beside(site: Site, label: str, s: float, left: float, yaw: float, case: str, number: int, *, touch: bool) -> None:
    """Place a partner that overlaps nothing but, if it may touch, the object it belongs to."""
    design = catalogue.choose(label, site.rng)
    mesh = design.build(site.rng)
    box = site.footprint(mesh, s, left, yaw)
    distance, _ = site.street.ground.edge([s], [left])
    if distance[0] < 0.05 or not site.start + box[2] < s < site.end - box[2]:
        return
    others = site.boxes
    if touch:
        kin = [
            row for row, other in zip(site.rows, site.placed, strict=True)
            if other.hard_case == case and other.label == TAXONOMY[label] and row >= 0
        ]  # fmt: skip
        others = np.delete(others, [*kin, site.rows[number]], axis=0)
    if overlaps(others, box, 0.02) < 0:
        site.add(design, mesh, s, left, yaw, hard_case=case)
