"""Pictures of simulated streets and of what stands on their lots, as docs/simulator.md shows them.

python benchmarks/street_pictures.py [town suburb campus ring_road premises] [--output docs/images]

Each street is looked at from where no camera of a survey is: free places above the road, in the survey's own sun. The
sheet `premises` has buildings, fences, walls and hedges, which are drawn lot by lot; they are no designs of the
catalogue.
"""

from __future__ import annotations

import argparse
import io
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from PIL import Image

from mlsroad_pipeline.reporting.clouds.design_sheet import photograph
from mlsroad_pipeline.simulation import PRESETS, SurveyStream
from mlsroad_pipeline.simulation.cameras.lighting import expose, radiance
from mlsroad_pipeline.simulation.furnishing.buildings import building, fence, wall
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS
from mlsroad_pipeline.simulation.plants.hedges import hedge
from mlsroad_pipeline.simulation.street.street import BLOCK

mpl.use("Agg")
import matplotlib.pyplot as plt

SIZE = (1000, 600)
FINER = 2  # rays per pixel and axis


class Shot(NamedTuple):
    """View of a street.

    Parameters
    ----------
    kind : str
        One of `STREETS`.
    seed : int
        Which street.
    station, offset, height : float
        The eye: metres along the street, to its left, above its ground.
    ahead : float
        How far ahead of the eye it looks, metres.
    aside, low : float
        Where: metres to the left of the centre line, above the ground.
    field : float
        Horizontal field of view, degrees.
    """

    kind: str
    seed: int
    station: float
    offset: float
    height: float
    ahead: float
    aside: float = 0.0
    low: float = 0.0
    field: float = 70.0


SHOTS = {
    "town": Shot("town", 4, 58.0, 1.5, 6.5, 35.0, low=1.0),
    "suburb": Shot("suburb", 3, 50.0, 1.0, 6.0, 35.0, low=1.0),
    "campus": Shot("campus", 102, 40.0, 1.5, 6.0, 35.0, low=1.5),
    "ring_road": Shot("ring_road", 302, 2.0, 1.0, 20.0, 30.0),
}


def picture(shot: Shot) -> np.ndarray:
    """Return what is seen from a place, shape (height, width, 3), uint8."""
    stream = SurveyStream(
        replace(PRESETS["demo"], seed=shot.seed, length=max(150.0, shot.station + 60), street=STREETS[shot.kind])
    )
    scene = stream.scene(int(shot.station // BLOCK))
    street = stream.street
    ends = np.array([[shot.station, shot.offset], [shot.station + shot.ahead, shot.aside]])
    xy, _ = street.alignment.place(ends[:, 0], ends[:, 1])
    z = street.ground.height(np.full(2, shot.station), np.zeros(2)) + np.array([shot.height, shot.low])
    eye, target = np.column_stack([xy, z])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    width, height = SIZE[0] * FINER, SIZE[1] * FINER
    v, u = np.divmod(np.arange(width * height), width)
    scale = np.tan(np.radians(shot.field) / 2) / (width / 2)
    x, y = (u - (width - 1) / 2) * scale, (v - (height - 1) / 2) * scale
    d = forward + x[:, None] * right + y[:, None] * np.cross(forward, right)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    rays = np.concatenate([np.broadcast_to(eye - scene.centre, d.shape), d], axis=1).astype(np.float32)
    times = np.full(len(rays), stream.drive.time_at(shot.station))
    hits = scene.cast(rays, times)
    surfaces = scene.resolve(hits, rays)
    seen = np.flatnonzero(np.isfinite(hits.distance))
    at = rays[seen, :3] + hits.distance[seen, None] * rays[seen, 3:] + 0.02 * stream.light.sun
    shadow = np.concatenate([at, np.broadcast_to(stream.light.sun, at.shape)], axis=1).astype(np.float32)
    lit = np.zeros(len(rays), np.bool_)
    lit[seen] = ~scene.occluded(shadow, times[seen])
    light_at = radiance(surfaces, hits.normal, rays, hits.distance, lit, stream.light)
    light_at = light_at.reshape(SIZE[1], FINER, SIZE[0], FINER, 3).mean(axis=(1, 3)).reshape(-1, 3)
    still = np.zeros_like(light_at)
    return expose(light_at, np.full(len(light_at), 1.15, np.float32), still).reshape(SIZE[1], SIZE[0], 3)


def premises() -> np.ndarray:
    """Return a sheet of buildings, fences, walls and hedges."""
    kinds = {
        "building with shops": lambda rng: building(rng, 14.0, shop=True),
        "house": lambda rng: building(rng, 10.0, plinth=0.5),
        "fence": lambda rng: fence(rng, 4.0), "wall": lambda rng: wall(rng, 4.0), "hedge": lambda rng: hedge(rng, 4.0),
    }  # fmt: skip
    figure, axes = plt.subplots(len(kinds), 6, figsize=(10, 7.6), dpi=100)
    for row, (name, build) in zip(axes, kinds.items(), strict=True):
        for seed, panel in enumerate(row):
            panel.imshow(photograph(build(np.random.default_rng(seed + 1)), size=(240, 200), azimuth=-1.15))
            panel.axis("off")
        row[0].set_title(name, fontsize=9, loc="left")
    figure.tight_layout(pad=0.3)
    page = io.BytesIO()
    figure.savefig(page, format="png")
    plt.close(figure)
    return np.asarray(Image.open(page).convert("RGB"))


def main() -> None:
    """Paint what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=[*SHOTS, "premises"])
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    for name in options.what:
        if name not in (*SHOTS, "premises"):
            parser.error(f"picture {name!r} is unknown (pictures: {', '.join(SHOTS)}, premises)")
        path = options.output / ("premises.jpg" if name == "premises" else f"street_{name}.jpg")
        Image.fromarray(premises() if name == "premises" else picture(SHOTS[name])).save(path, quality=82)
        print(path)


if __name__ == "__main__":
    main()
