"""Three cameras on the van: images of the scene under sun and sky, and their labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.simulation.drive import RATE, Drive
from mlsroad_pipeline.algorithms.simulation.lighting import Light, shade
from mlsroad_pipeline.algorithms.simulation.meshes import rotation_matrix
from mlsroad_pipeline.algorithms.simulation.presets import SimulationParameters
from mlsroad_pipeline.algorithms.simulation.scene import RayScene
from mlsroad_pipeline.algorithms.simulation.street import generator

CAMERAS: dict[str, tuple[float, float, tuple[float, float, float], float]] = {
    "front_left": (np.radians(24.0), np.radians(6.0), (0.35, 0.4, 0.25), np.radians(75.0)),
    "front_right": (np.radians(-24.0), np.radians(6.0), (0.35, -0.4, 0.25), np.radians(75.0)),
    "back": (np.pi, np.radians(8.0), (-0.6, 0.0, 0.25), np.radians(85.0)),
}
"""Yaw and pitch (nose down) in the van's frame, place on it (m), horizontal field of view (radians)."""

# A camera looks along +z, x to the right, y down; the van's x is forward, y left, z up.
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Image:
    """An image with its calibration and pose.

    A point p, in world coordinates minus the survey's origin, is at R p + t in the camera's frame (x right, y down, z
    forward) and at K (R p + t) in homogeneous pixel coordinates; pixel centres have integer coordinates.

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
    R : ndarray of shape (3, 3), float64
        Rotation, by the reported trajectory.
    t : ndarray of shape (3,), float64
        Translation, metres.
    K : ndarray of shape (3, 3), float64
        Calibration, pixels.
    width, height : int
        Size, pixels.
    """

    name: str
    camera: str
    time: float
    rgb: NDArray[np.uint8]
    label: NDArray[np.uint8]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    K: NDArray[np.float64]
    width: int
    height: int


def calibration(camera: str, parameters: SimulationParameters) -> NDArray[np.float64]:
    """Return a camera's K: square pixels, principal point a little off the middle.

    Parameters
    ----------
    camera : str
        One of `CAMERAS`.
    parameters : SimulationParameters
        Image size.

    Returns
    -------
    ndarray of shape (3, 3), float64
        The calibration matrix, pixels; pixel centres have integer coordinates.

    Raises
    ------
    KeyError
        If there is no such camera.
    """
    width, height = parameters.image_width, parameters.image_height
    focal = 0.5 * width / np.tan(CAMERAS[camera][3] / 2)
    off = {"front_left": 0.006, "front_right": -0.004, "back": 0.003}[camera]
    return np.array(
        [[focal, 0, (width - 1) / 2 + off * width], [0, focal, (height - 1) / 2 - off * width], [0, 0, 1.0]]
    )


def camera_pose(camera: str, pose: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation and translation of a camera on the van.

    Parameters
    ----------
    camera : str
        One of `CAMERAS`.
    pose : ndarray of shape (6,), float64
        The van's x, y, z (street-local metres), roll, pitch, heading (radians; see `Drive`).

    Returns
    -------
    rotation : ndarray of shape (3, 3), float64
        R of `Image`: from street-local axes to the camera's.
    translation : ndarray of shape (3,), float64
        t of `Image`, metres.

    Raises
    ------
    KeyError
        If there is no such camera.
    """
    yaw, pitch, lever, _ = CAMERAS[camera]
    van = rotation_matrix(pose[5], pose[4], pose[3])
    rotation = _AXES @ (van @ rotation_matrix(yaw, pitch, 0.0)).T
    return rotation, -rotation @ (pose[:3] + van @ np.array(lever))


def pose_at(poses: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Interpolate a pose linearly; before the first and after the last it is held.

    Parameters
    ----------
    poses : ndarray of shape (m, 6), float64
        At least two poses, `RATE` per second from time 0 on; angles must be continuous.
    time : float
        Seconds since the start.

    Returns
    -------
    ndarray of shape (6,), float64
        The pose.
    """
    u = min(max(time * RATE, 0.0), len(poses) - 1.000001)
    k = int(u)
    row: NDArray[np.float64] = poses[k] + (u - k) * (poses[k + 1] - poses[k])
    return row


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
    """Take one image.

    Parameters
    ----------
    scene : RayScene
        What there is to see.
    drive : Drive
        Where the van is.
    light : Light
        Sun and sky.
    parameters : SimulationParameters
        Image size and the clock.
    camera : str
        One of `CAMERAS`.
    time : float
        Seconds since the start.
    name : str
        Name of the image.

    Returns
    -------
    image : Image
        The image, posed by the reported trajectory.
    depth : ndarray of shape (height, width), float32
        Depth along the optical axis in metres, infinite in the sky.
    """
    k = calibration(camera, parameters)
    rotation, translation = camera_pose(camera, pose_at(drive.true, time))
    width, height = parameters.image_width, parameters.image_height
    eye = -rotation.T @ translation - scene.centre
    rays, cosine = _pixel_rays(width, height, k, rotation, eye)
    times = np.full(len(rays), time)
    hits = scene.cast(rays, times)
    surfaces = scene.resolve(hits, rays)
    rows, shadow = _shadow_rays(hits.distance, hits.normal, rays, light.sun)
    lit = np.zeros(len(rays), dtype=np.bool_)
    lit[rows] = ~scene.occluded(shadow, times[: len(rows)])
    rng = generator(scene.street.seed, 41, round(time * RATE), sorted(CAMERAS).index(camera))
    grain = rng.standard_normal((len(rays), 3), dtype=np.float32)
    rgb = shade(surfaces, hits.normal, rays, hits.distance, lit, light, grain).reshape(height, width, 3)
    r, t = camera_pose(camera, pose_at(drive.reported, time))
    label = surfaces.label.reshape(height, width)
    image = Image(name, camera, time + drive.start, rgb, label, r, t, k, width, height)
    return image, (hits.distance * cosine).astype(np.float32).reshape(height, width)


@njit(cache=True, nogil=True)
def _pixel_rays(
    width: int, height: int, k: NDArray[np.float64], rotation: NDArray[np.float64], eye: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the rays through the pixels' centres, row by row, and their cosines to the optical axis."""
    rays, cosine = np.empty((width * height, 6), dtype=np.float32), np.empty(width * height, dtype=np.float32)
    for v in range(height):
        for u in range(width):
            i = v * width + u
            x, y = (u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1]
            c = 1.0 / np.sqrt(x * x + y * y + 1.0)
            cosine[i] = c
            for r in range(3):
                rays[i, r] = eye[r]
                rays[i, 3 + r] = c * (x * rotation[0, r] + y * rotation[1, r] + rotation[2, r])
    return rays, cosine


@njit(cache=True, nogil=True)
def _shadow_rays(
    distance: NDArray[np.float32], normal: NDArray[np.float32], rays: NDArray[np.float32], sun: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return rays towards the sun from where rays met a face that looks at it, and which rays those are."""
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
