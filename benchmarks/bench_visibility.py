"""Visibility of points in images: accuracy against ray casting on simulated streets, speed compared with Open3D.

    python benchmarks/bench_visibility.py accuracy|speed [--seeds N ...] [--streets KIND ...] [--every N]
        [--pulse-rate HZ --profile-rate HZ]

`accuracy` scans streets, casts a ray from each camera to every point in its image, and scores each method. A point is
visible where the ray reaches it within 6 cm plus 1 % of its distance, or within 6 cm across the surface that the ray
met. Rays go from the true place of the camera to the true place of the point; the methods get the survey as recorded,
with the errors of trajectory, boresight and lever arms (1 to 3 cm). Points of moving objects and points hidden by one
are left out. The scanner sends 550,000 pulses in 200 profiles a second. Defaults were chosen on towns of seeds 101 and
111, suburbs of 102 and 112 and ring roads of 103 and 113. `speed` takes a million points of a street in one image.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import open3d as o3d
from _common import parser, race, show
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import (
    DepthBuffer,
    HiddenPointRemoval,
    hidden_point_removal,
    visible_points,
)
from mlsroad_pipeline.simulation import PRESETS, SurveyStream
from mlsroad_pipeline.simulation.cameras.cameras import camera_pose
from mlsroad_pipeline.simulation.parameters.street_parameters import street_parameters
from mlsroad_pipeline.simulation.rays.scene import RayScene
from mlsroad_pipeline.simulation.street.drive import pose_at

RUNS = 5
"""Runs of which the median time is printed."""

METHODS = {"depth buffer": DepthBuffer(), "hidden point removal": HiddenPointRemoval()}


@dataclass(frozen=True)
class View:
    """One image's camera, all points as recorded, and the truth about those inside the image."""

    camera: Camera
    xyz: NDArray[np.float64]
    rows: NDArray[np.int64]
    visible: NDArray[np.bool_]
    moving: NDArray[np.bool_]
    behind_moving: NDArray[np.bool_]


Rates = tuple[float | None, float | None]
"""Pulses and profiles per second; None are the scanner's own."""


def views(kind: str, seed: int, every: int, rates: Rates) -> Iterator[View]:
    """Scan a street and cast rays to the points of every so many images."""
    parameters = replace(
        PRESETS["small"], seed=seed, street=street_parameters(kind), pulse_rate=rates[0], profile_rate=rates[1],
        image_interval=16.0,
    )  # fmt: skip
    stream = SurveyStream(parameters)
    exact = SurveyStream(replace(parameters, trajectory_noise=0.0, boresight_error=0.0))  # the same pulses
    scenes = [stream.scene(number) for number in range(stream.block_count())]
    spans = [(scene, *span) for number, scene in enumerate(scenes) for span in stream.spans(number)]
    clouds = [stream.scan_span(*span) for span in spans]
    xyz = np.concatenate([cloud.xyz for cloud in clouds])
    instance = np.concatenate([cloud["instance"] for cloud in clouds])
    places = np.concatenate([exact.scan_span(*span).xyz for span in spans])
    movers = [mover.instance for scene in scenes for mover in scene.movers]
    moments = [(scene, moment) for number, scene in enumerate(scenes) for moment in stream.moments(number)]
    shots = [(scene, image) for scene, moment in moments for image in stream.shoot(scene, moment)[0]]
    for scene, image in shots[::every]:
        camera = Camera(image.K, image.distortion, image.R, image.t, image.width, image.height)
        rows = np.flatnonzero(project_points(xyz, camera)[2])
        time_ = image.time - stream.drive.start
        rotation, translation = camera_pose(image.camera, pose_at(stream.drive.true, time_))
        eye = -rotation.T @ translation
        visible, hit = reached(scene, eye, places[rows], time_)
        behind = ~visible & np.isin(hit, movers)
        yield View(camera, xyz, rows, visible, np.isin(instance, movers), behind)


def reached(
    scene: RayScene, eye: NDArray[np.float64], xyz: NDArray[np.float64], when: float
) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Return whether rays from a place reach points, and the instances that they meet."""
    towards = xyz - eye
    distance = np.linalg.norm(towards, axis=1)
    towards /= distance[:, None]
    origins = np.broadcast_to(eye - scene.centre, towards.shape)
    hits = scene.cast(np.concatenate([origins, towards], axis=1).astype(np.float32), np.full(len(xyz), when))
    slant = np.maximum(np.abs((hits.normal * towards).sum(axis=1)), 0.01)
    visible = distance - hits.distance <= np.maximum(0.06 + 0.01 * distance, 0.06 / slant)
    return visible, np.where(hits.face >= 0, scene.instances[hits.face], np.int32(0))


def accuracy(streets: list[str], seeds: list[int], every: int, rates: Rates) -> None:
    """Print the F1 of visible and of hidden points of every method on every street."""
    for kind, seed in product(streets, seeds):
        counts = {name: np.zeros(4, dtype=np.int64) for name in METHODS}
        for view in views(kind, seed, every, rates):
            still = np.flatnonzero(~view.moving)
            keep = ~view.moving[view.rows] & ~view.behind_moving
            for name, method in METHODS.items():
                seen = np.zeros(len(view.xyz), dtype=bool)
                seen[still] = visible_points(view.xyz[still], view.camera, method=method)
                counts[name] += np.bincount(view.visible[keep] * 2 + seen[view.rows][keep], minlength=4)
        for name, (hidden, wrongly_seen, wrongly_hidden, visible) in counts.items():
            wrong, total = wrongly_seen + wrongly_hidden, int(counts[name].sum())
            row = {"stage": "visibility", "street": kind, "seed": seed, "method": name, "points": total}
            row |= {"hidden": (hidden + wrongly_seen) / total, "f1_visible": 2 * visible / (2 * visible + wrong)}
            print(json.dumps(row | {"f1_hidden": 2 * hidden / (2 * hidden + wrong)}), flush=True)


def speed(seed: int) -> None:
    """Time each method, and Open3D, on one image and a million points in it, and compare what Open3D sees."""
    view = max(views("town", seed, 3, (120_000.0, 150.0)), key=lambda view: len(view.rows))
    inside = view.xyz[view.rows]
    rng = np.random.default_rng(0)
    xyz = inside[np.sort(np.resize(np.arange(len(inside)), 1_000_000))] + rng.normal(0, 0.002, (1_000_000, 3))
    radius = float(np.linalg.norm(xyz - view.camera.centre, axis=1).max()) * 1000
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz))
    runs = {
        "depth buffer": lambda: visible_points(xyz, view.camera),
        "hidden point removal": lambda: visible_points(xyz, view.camera, method=HiddenPointRemoval()),
        "hidden point removal on points": lambda: hidden_point_removal(xyz, view.camera.centre, radius=radius),
        "hidden point removal on points, Open3D": lambda: cloud.hidden_point_removal(view.camera.centre, radius),
    }
    found = race(runs, repeats=RUNS, warm_up=1)
    for name, timed in found.items():
        kernel, _, other = name.partition(", ")
        show(kernel, len(xyz), {other or "mlsroad": timed})
    ours = np.flatnonzero(found["hidden point removal on points"].result)
    theirs = np.sort(found["hidden point removal on points, Open3D"].result[1])
    differing = len(np.setxor1d(ours, theirs))
    print(f"visible by hidden point removal: {len(ours)} points, by Open3D {len(theirs)}, differing {differing}")


def main() -> None:
    """Run the benchmark."""
    arguments = parser(__doc__)
    arguments.add_argument("what", choices=["accuracy", "speed"])
    arguments.add_argument("--streets", nargs="+", default=["town", "suburb", "ring_road"])
    arguments.add_argument("--seeds", nargs="+", type=int, default=[204])
    arguments.add_argument("--every", type=int, default=6, help="score every so many images")
    arguments.add_argument("--pulse-rate", type=float, help="pulses per second of each scanner, by default its own")
    arguments.add_argument("--profile-rate", type=float, help="profiles per second of each scanner, by default its own")
    options = arguments.parse_args()
    if options.what == "accuracy":
        accuracy(options.streets, options.seeds, options.every, (options.pulse_rate, options.profile_rate))
    else:
        speed(options.seeds[0])


if __name__ == "__main__":
    main()
