"""Scans drawn over the camera images of a recording, to be looked at, and how well edges of both lie upon each other.

Run as ``python benchmarks/camera_overlays.py --folder FOLDER --out FOLDER``, with a folder of SUSTech's recordings:
``NAME.pcd``, ``CAMERA_NAME.jpg`` and ``CAMERA.json`` with `extrinsic` (scanner to camera) and `intrinsic`.

Points that the camera sees are drawn by their distance, near ones red. Beside each picture stands where the edges of
things in the scan lie relative to those in the image: points that stand more than a metre before the next one of
their ring should lie on edges of the image. The mean brightness step there is taken for the projection shifted by up
to 20 pixels to the left and to the right; the shift with the greatest is printed, and should be near 0.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture
from scipy.ndimage import gaussian_filter

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.papers.tomic2019.image_labels.visibility import visible_points

CAMERAS = ("front", "left", "right")
SHIFTS = np.arange(-20, 21)
BEYOND = 8.0  # metres; a fence before the camera has edges everywhere


def read_camera(path: Path, width: int, height: int) -> Camera:
    """Read a camera as SUSTech's recordings tell it."""
    given = json.loads(path.read_text(encoding="utf-8"))
    pose = np.array(given["extrinsic"]).reshape(4, 4)
    u, _, v = np.linalg.svd(pose[:3, :3])  # its numbers are rounded: the nearest rotation
    return Camera(np.array(given["intrinsic"]).reshape(3, 3), None, u @ v, pose[:3, 3], width, height)


def silhouettes(xyz: NDArray[np.float64], *, step: float = 1.0) -> NDArray[np.int64]:
    """Return the points that stand more than a step before one beside them as the scanner sees them."""
    azimuth = np.arctan2(xyz[:, 1], xyz[:, 0])
    distance = np.linalg.norm(xyz, axis=1)
    elevation = np.round(np.degrees(np.arcsin(xyz[:, 2] / distance)) / 0.1)
    order = np.lexsort([azimuth, elevation])
    beside = (np.diff(elevation[order]) == 0) & (np.diff(azimuth[order]) < np.radians(0.6))
    farther = np.diff(distance[order])
    chosen = np.concatenate([order[:-1][beside & (farther > step)], order[1:][beside & (farther < -step)]])
    return np.unique(chosen)


def best_shift(picture: NDArray[np.uint8], pixels: NDArray[np.float64]) -> tuple[int, float]:
    """Return the shift at which the points lie on the strongest edges, pixels, and how strong they are there."""
    grey = gaussian_filter(picture.astype(np.float64).mean(axis=2), 1.5)
    edge = np.abs(np.gradient(grey, axis=1))
    rows, columns = np.floor(pixels[:, ::-1] + 0.5).astype(np.int64).T
    keep = (columns >= 20) & (columns < edge.shape[1] - 20)
    strength = np.array([edge[rows[keep], columns[keep] + shift].mean() for shift in SHIFTS])
    best = int(strength.argmax())
    return int(SHIFTS[best]), float(strength[best] / edge.mean())


def draw(picture: NDArray[np.uint8], pixels: NDArray[np.float64], distance: NDArray[np.float64]) -> Picture.Image:
    """Draw points over a picture, near ones red and far ones blue."""
    out = (picture * 0.6).astype(np.uint8)
    near = np.clip(1 - np.log(np.maximum(distance, 4) / 4) / np.log(15), 0, 1)
    colour = np.column_stack([255 * near, 255 * (1 - np.abs(2 * near - 1)), 255 * (1 - near)]).astype(np.uint8)
    order = np.argsort(-distance)
    rows, columns = np.floor(pixels[order, ::-1] + 0.5).astype(np.int64).T
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            r, c = np.clip(rows + down, 0, len(out) - 1), np.clip(columns + right, 0, out.shape[1] - 1)
            out[r, c] = colour[order]
    return Picture.fromarray(out)


def overlay(folder: Path, camera: str) -> tuple[Picture.Image, dict[str, float]]:
    """Project the scan of a folder into one camera's image, and tell what came of it."""
    (scan,) = folder.glob("*.pcd")
    cloud = PcdFormat().read(scan, ReadOptions())
    xyz = cloud.world_xyz()
    xyz = xyz[np.isfinite(xyz).all(axis=1) & (np.linalg.norm(xyz, axis=1) > 1.0)]
    picture = np.asarray(Picture.open(folder / f"{camera}_{scan.stem}.jpg").convert("RGB"), dtype=np.uint8)
    view = read_camera(folder / f"{camera}.json", picture.shape[1], picture.shape[0])
    pixels, depth, inside = project_points(xyz, view)
    seen = visible_points(xyz, view)
    edges = np.zeros(len(xyz), dtype=np.bool_)
    edges[silhouettes(xyz)] = True
    edges &= depth > BEYOND
    shift, strength = best_shift(picture, pixels[edges & seen])
    told = {
        "inside": int(inside.sum()),
        "seen": int(seen.sum()),
        "edges": int((edges & seen).sum()),
        "shift": shift,
        "strength": strength,
    }
    return draw(picture, pixels[seen], depth[seen]), told


def main() -> None:
    """Draw the overlays of all cameras."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for camera in CAMERAS:
        picture, told = overlay(options.folder, camera)
        picture.save(options.out / f"overlay_{camera}.jpg", quality=90)
        print(
            f"{camera:<6}{told['inside']:>7} points in the image, {told['seen']:>6} seen; {told['edges']} of them on "
            f"edges, best at {told['shift']:+d} pixels, {told['strength']:.2f} times the image's mean edge"
        )


if __name__ == "__main__":
    main()
