"""Three cameras on the van: images of the scene with label and instance images, and the colours of points from them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.geometry.lenses import distort_one, trusted_radius, undistort
from mlsroad_pipeline.simulation.cameras.lighting import Light, expose, radiance
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.parameters.presets import SimulationParameters
from mlsroad_pipeline.simulation.rays.scene import RayScene
from mlsroad_pipeline.simulation.street.drive import RATE, Drive, pose_at, pose_between
from mlsroad_pipeline.simulation.street.street import generator

CAMERAS: dict[str, tuple[float, float, tuple[float, float, float], float]] = {
    "front_left": (np.radians(24.0), np.radians(6.0), (0.35, 0.4, 0.25), np.radians(75.0)),
    "front_right": (np.radians(-24.0), np.radians(6.0), (0.35, -0.4, 0.25), np.radians(75.0)),
    "back": (np.pi, np.radians(8.0), (-0.6, 0.0, 0.25), np.radians(85.0)),
}
"""Yaw and pitch (nose down) in the van's frame, place on it (m), horizontal field of view (radians)."""

DISTORTION: dict[str, tuple[float, float, float, float, float]] = {
    "front_left": (-0.105, 0.021, 0.0006, -0.0004, -0.0012),
    "front_right": (-0.098, 0.018, -0.0003, 0.0005, -0.0009),
    "back": (-0.118, 0.022, 0.0002, 0.0003, -0.0014),
}
"""k1, k2, p1, p2, k3 of each camera's lens; see `distort`."""

# The camera's axes: x right, y down, z forward. The van's: x forward, y left, z up.
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])

_TRIES = 24  # images tested for one point's colour
_DEPTH_SLACK = 0.06  # metres, and 1 % of the depth


@dataclass(frozen=True)
class Image:
    """An image with its calibration and pose.

    A point p, in world coordinates minus the survey's origin, is at R p + t in the camera's frame (x right, y down, z
    forward); divided by its z, distorted and multiplied by K it is a pixel. Pixel centres have integer coordinates. The
    pose is that of the middle row; other rows are exposed earlier or later.

    Parameters
    ----------
    name : str
        File stem, unique in the survey.
    camera : str
        One of `CAMERAS`.
    time : float
        GPS seconds.
    rgb : ndarray of shape (height, width, 3), uint8
        The image.
    label : ndarray of shape (height, width), uint8
        Taxonomy codes, 0 in the sky.
    instance : ndarray of shape (height, width), int32
        Instances, 0 is none.
    R : ndarray of shape (3, 3), float64
        Rotation, by the reported trajectory.
    t : ndarray of shape (3,), float64
        Translation, metres.
    K : ndarray of shape (3, 3), float64
        Calibration, pixels.
    distortion : ndarray of shape (5,), float64
        k1, k2, p1, p2, k3; see `distort`.
    width, height : int
        Size, pixels.
    """

    name: str
    camera: str
    time: float
    rgb: NDArray[np.uint8]
    label: NDArray[np.uint8]
    instance: NDArray[np.int32]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    K: NDArray[np.float64]
    distortion: NDArray[np.float64]
    width: int
    height: int


def calibration(camera: str, parameters: SimulationParameters) -> NDArray[np.float64]:
    """Return the (3, 3) calibration matrix of a camera: square pixels, principal point a little off the middle."""
    width, height = parameters.image_width, parameters.image_height
    focal = 0.5 * width / np.tan(CAMERAS[camera][3] / 2)
    off = {"front_left": 0.006, "front_right": -0.004, "back": 0.003}[camera]
    return np.array(
        [[focal, 0, (width - 1) / 2 + off * width], [0, focal, (height - 1) / 2 - off * width], [0, 0, 1.0]]
    )


def camera_pose(camera: str, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation and translation of a camera, R and t of `Image`.

    `pose` has the van's x, y, z (street-local metres), roll, pitch and heading (radians; see `Drive`).
    """
    yaw, pitch, lever, _ = CAMERAS[camera]
    van = rotation_matrix(pose[5], pose[4], pose[3])
    rotation = _AXES @ (van @ rotation_matrix(yaw, pitch, 0.0)).T
    return rotation, -rotation @ (pose[:3] + van @ np.array(lever))


def take_image(
    scene: RayScene,
    drive: Drive,
    light: Light,
    parameters: SimulationParameters,
    *,
    camera: str,
    time: float,
    name: str,
) -> tuple[Image, NDArray[np.float32]]:
    """Take one image, posed by the reported trajectory, and return it with its depth along the optical axis.

    `time` is in seconds since the start; depths are in metres, infinite in the sky.
    """
    width, height = parameters.image_width, parameters.image_height
    k, distortion = calibration(camera, parameters), np.array(DISTORTION[camera])
    yaw, pitch, lever, _ = CAMERAS[camera]
    mounting = rotation_matrix(yaw, pitch, 0.0) @ _AXES.T
    rays, cosine, times = _pixel_rays(
        width, height, _directions(k.tobytes(), distortion.tobytes(), width, height), mounting, np.array(lever),
        drive.true, scene.centre, time, parameters.image_readout,
    )  # fmt: skip
    hits = scene.cast(rays, times)
    surfaces = scene.resolve(hits, rays)
    rows, shadow = _shadow_rays(hits.distance, hits.normal, rays, light.sun)
    lit = np.zeros(len(rays), dtype=np.bool_)
    lit[rows] = ~scene.occluded(shadow, times[rows])
    light_at = radiance(surfaces, hits.normal, rays, hits.distance, lit, light)
    rng = generator(scene.street.seed, 41, round(time * RATE), sorted(CAMERAS).index(camera))
    grain = rng.standard_normal((len(rays), 3), dtype=np.float32)
    rgb = expose(light_at, _exposure(light_at, cosine), grain)
    r, t = camera_pose(camera, pose_at(drive.reported, time))
    instance = np.where(hits.face >= 0, scene.instances[hits.face], np.int32(0))
    image = Image(
        name, camera, time + drive.start, rgb.reshape(height, width, 3), surfaces.label.reshape(height, width),
        instance.reshape(height, width), r, t, k, distortion, width, height,
    )  # fmt: skip
    return image, (hits.distance * cosine).astype(np.float32).reshape(height, width)


def _exposure(light_at: NDArray[np.float32], cosine: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the factor of automatic exposure and vignetting at each pixel."""
    gain = np.clip((0.42 / max(float(light_at.mean()), 1e-3)) ** 0.6, 0.6, 1.7)
    shade: NDArray[np.float32] = np.float32(gain) * (np.float32(0.45) + np.float32(0.55) * cosine**4)
    return shade


@lru_cache(maxsize=8)
def _directions(k: bytes, distortion: bytes, width: int, height: int) -> NDArray[np.float64]:
    """Return the unit directions of the pixel centres in the camera's frame, row by row."""
    matrix = np.frombuffer(k).reshape(3, 3)
    v, u = np.divmod(np.arange(width * height), width)
    plane = np.column_stack([(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1]])
    directions = np.column_stack([undistort(plane, np.frombuffer(distortion)), np.ones(len(plane))])
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@njit(cache=True, nogil=True)
def _pixel_rays(
    width: int, height: int, directions: NDArray[np.float64], mounting: NDArray[np.float64],
    lever: NDArray[np.float64], poses: NDArray[np.float64], centre: NDArray[np.float64], time: float, readout: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:  # fmt: skip
    """Return the rays through the pixel centres, row by row, their cosines to the optical axis and their times."""
    rays, cosine = np.empty((width * height, 6), dtype=np.float32), np.empty(width * height, dtype=np.float32)
    times = np.empty(width * height)
    position, turn, ends = np.empty(3), np.empty((3, 3)), np.empty((2, 3, 3))
    knot = -1
    for v in range(height):
        moment = time + readout * (v / (height - 1) - 0.5)
        knot = pose_between(moment, poses, knot, ends, position, turn)
        looking = turn @ mounting
        eye = position + turn @ lever - centre
        for u in range(width):
            i = v * width + u
            cosine[i], times[i] = directions[i, 2], moment
            for r in range(3):
                rays[i, r] = eye[r]
                rays[i, 3 + r] = (
                    looking[r, 0] * directions[i, 0]
                    + looking[r, 1] * directions[i, 1]
                    + looking[r, 2] * directions[i, 2]
                )
    return rays, cosine, times


@njit(cache=True, nogil=True)
def _shadow_rays(
    distance: NDArray[np.float32], normal: NDArray[np.float32], rays: NDArray[np.float32], sun: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return rays towards the sun from hits on faces turned to it, and the rows of these hits."""
    rows, shadow = np.empty(len(distance), dtype=np.int64), np.empty((len(distance), 6), dtype=np.float32)
    n = 0
    for i in range(len(distance)):
        if not np.isfinite(distance[i]):
            continue
        to_eye = -(normal[i, 0] * rays[i, 3] + normal[i, 1] * rays[i, 4] + normal[i, 2] * rays[i, 5])
        to_sun = normal[i, 0] * sun[0] + normal[i, 1] * sun[1] + normal[i, 2] * sun[2]
        if to_eye * to_sun <= 0:
            continue
        rows[n] = i
        for r in range(3):
            shadow[n, r] = rays[i, r] + distance[i] * rays[i, 3 + r] + 0.02 * sun[r]
            shadow[n, 3 + r] = sun[r]
        n += 1
    return rows[:n], shadow[:n]


def colour_points(
    xyz: NDArray[np.float64], times: NDArray[np.float64], images: list[Image], depths: list[NDArray[np.float32]]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours of points from the temporally nearest image that shows them, and which points have one.

    `xyz` is (n, 3), world minus origin, metres; `times` are GPS seconds. Images are in the order of time, each with its
    depth image in metres. Colours are uint8, black for points in no image.
    """
    if not images:
        return np.zeros((len(xyz), 3), dtype=np.uint8), np.zeros(len(xyz), dtype=np.bool_)
    return _colour_points(
        xyz, times, np.array([i.time for i in images]), np.stack([i.rgb for i in images]), np.stack(depths),
        np.stack([i.R for i in images]), np.stack([i.t for i in images]), np.stack([i.K for i in images]),
        np.stack([i.distortion for i in images]),
        np.array([trusted_radius(i.K, i.distortion, i.width, i.height) for i in images]),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _colour_points(
    xyz: NDArray[np.float64], times: NDArray[np.float64], taken: NDArray[np.float64], rgb: NDArray[np.uint8],
    depth: NDArray[np.float32], rotations: NDArray[np.float64], translations: NDArray[np.float64],
    calibrations: NDArray[np.float64], lenses: NDArray[np.float64], trusted: NDArray[np.float64],
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:  # fmt: skip
    n, m = len(xyz), len(taken)
    height, width = depth.shape[1:]
    colours, seen = np.zeros((n, 3), dtype=np.uint8), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        after = np.searchsorted(taken, times[i])
        before = after - 1
        for _ in range(_TRIES):
            if before < 0 and after >= m:
                break
            if after >= m or (before >= 0 and times[i] - taken[before] <= taken[after] - times[i]):
                j = before
                before -= 1
            else:
                j = after
                after += 1
            r, t, k = rotations[j], translations[j], calibrations[j]
            z = r[2, 0] * xyz[i, 0] + r[2, 1] * xyz[i, 1] + r[2, 2] * xyz[i, 2] + t[2]
            if z < 0.3:
                continue
            x = r[0, 0] * xyz[i, 0] + r[0, 1] * xyz[i, 1] + r[0, 2] * xyz[i, 2] + t[0]
            y = r[1, 0] * xyz[i, 0] + r[1, 1] * xyz[i, 1] + r[1, 2] * xyz[i, 2] + t[1]
            x, y = x / z, y / z
            if x * x + y * y > trusted[j]:
                continue
            x, y = distort_one(x, y, lenses[j])
            u, v = int(np.floor(k[0, 0] * x + k[0, 2] + 0.5)), int(np.floor(k[1, 1] * y + k[1, 2] + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height or z > depth[j, v, u] * 1.01 + _DEPTH_SLACK:
                continue
            colours[i] = rgb[j, v, u]
            seen[i] = True
            break
    return colours, seen


@njit(cache=True, nogil=True)
def spread_colours(
    xyz: NDArray[np.float64], scanner: NDArray[np.uint8], rgb: NDArray[np.uint8], seen: NDArray[np.bool_], reach: float
) -> NDArray[np.uint8]:
    """Colour the remaining points like the nearer of the previous and the next coloured point of their scanner.

    Points are in the order of time; `reach` is the largest distance in metres, beyond which points stay black.
    """
    n = len(xyz)
    out = rgb.copy()
    best = np.full(n, reach * reach)
    for backwards in range(2):
        last = np.full(256, -1, dtype=np.int64)
        for step in range(n):
            i = n - 1 - step if backwards else step
            if seen[i]:
                last[scanner[i]] = i
                continue
            j = last[scanner[i]]
            if j < 0:
                continue
            apart = (xyz[i, 0] - xyz[j, 0]) ** 2 + (xyz[i, 1] - xyz[j, 1]) ** 2 + (xyz[i, 2] - xyz[j, 2]) ** 2
            if apart < best[i]:
                best[i] = apart
                out[i] = rgb[j]
    return out
