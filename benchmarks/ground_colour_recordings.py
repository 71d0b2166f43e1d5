"""Paved and natural ground of recordings with camera colours, labelled with and without colour.

    python benchmarks/ground_colour_recordings.py [--model pool]

Paints the scans of `$MLSROAD_DATA` with the images taken with them, labels each with colour and without, and prints
IoU and F1 of natural and of paved ground over the points of each recording that have a colour and a true class of
ground: three scans of SemanticKITTI (terrain; road, parking, sidewalk, other ground), four frames of PandaSet (ground;
road, markings, sidewalk, driveway), and the four frames of `kitti_painted`, whose classes are those of a network on the
image (terrain; road, sidewalk). The two Amsterdam tiles have no such classes; for them it prints the share of natural
ground.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import laspy
import numpy as np
from _common import DATA, parser
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.models.labelling import label_cloud
from mlsroad_pipeline.algorithms.models.pool.labeller import ground_classes
from mlsroad_pipeline.model_store.shipped_models import load_shipped

PAVED, NATURAL, UNKNOWN = 0, 1, -1
CELL = 4  # pixels of the depth image that hides the points behind


class Painted(NamedTuple):
    """A scan with colours, and the true ground of its points: paved, natural or unknown."""

    recording: str
    cloud: PointCloud
    truth: NDArray[np.int8]


def painted(recording: str, xyz: NDArray, intensity: NDArray, image: Path, matrix: NDArray, kinds: NDArray) -> Painted:
    """Return a scan with the colours of an image; `matrix` (3, 4) projects points to pixels. Hidden ones are black."""
    pixels = np.asarray(Image.open(image).convert("RGB"))
    u, v, depth = matrix @ np.column_stack([xyz, np.ones(len(xyz))]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = np.floor(u / depth + 0.5), np.floor(v / depth + 0.5)
    inside = (depth > 0.5) & (column >= 0) & (row >= 0) & (column < pixels.shape[1]) & (row < pixels.shape[0])
    column, row, depth = column[inside].astype(int), row[inside].astype(int), depth[inside]
    nearest = np.full((pixels.shape[0] // CELL + 1, pixels.shape[1] // CELL + 1), np.inf)
    np.minimum.at(nearest, (row // CELL, column // CELL), depth)
    shown = depth < nearest[row // CELL, column // CELL] * 1.05 + 0.3
    rgb = np.zeros((len(xyz), 3), np.uint8)
    rgb[np.flatnonzero(inside)[shown]] = pixels[row[shown], column[shown]]
    cloud = PointCloud(
        xyz.astype(np.float64), {"intensity": intensity.astype(np.float32), "rgb": rgb}, source=image.name
    )
    return Painted(recording, cloud, kinds.astype(np.int8))


def kinds_of(codes: NDArray, paved: list[int], natural: list[int]) -> NDArray[np.int8]:
    """Return paved, natural or unknown for the codes of a recording."""
    return np.select([np.isin(codes, paved), np.isin(codes, natural)], [PAVED, NATURAL], UNKNOWN).astype(np.int8)


def semantickitti() -> Iterator[Painted]:
    """Read three scans of SemanticKITTI with their images."""
    drive, more = DATA / "real/semantickitti_00_images/sequences/00", DATA / "real/semantickitti_more/makeonebug"
    lines = dict(line.split(":") for line in (drive / "calib.txt").read_text().splitlines() if ":" in line)
    camera, scanner = (np.array(lines[name].split(), float).reshape(3, 4) for name in ("P2", "Tr"))
    for scan in ("000000", "000001", "000002"):
        points = np.fromfile(drive / f"velodyne/{scan}.bin", np.float32).reshape(-1, 4)
        codes = np.fromfile(more / f"label/{scan}.label", np.uint32) & 0xFFFF
        kinds = kinds_of(codes, [40, 44, 48, 49, 60], [72])
        matrix = camera @ np.vstack([scanner, [0, 0, 0, 1]])
        yield painted("SemanticKITTI", points[:, :3], points[:, 3], drive / f"image_2/{scan}.png", matrix, kinds)


def kitti_painted() -> Iterator[Painted]:
    """Read the four painted frames of KITTI."""
    folder = DATA / "kitti_painted"
    known = {name: np.array(value) for name, value in json.loads((folder / "calibration.json").read_text()).items()}
    matrix = known["P2"][:3] @ known["rectification"] @ known["lidar_to_camera"]
    for frame in ("000000", "000005", "000010", "000015"):
        points = np.fromfile(folder / f"{frame}.bin", np.float32).reshape(-1, 4)
        codes = np.fromfile(folder / f"{frame}_painted.bin", np.float32).reshape(-1, 4)[:, 3]
        kinds = kinds_of(codes, [0, 1], [9])
        yield painted(f"KITTI {frame}", points[:, :3], points[:, 3], folder / f"{frame}.png", matrix, kinds)


def pandaset() -> Iterator[Painted]:
    """Read the four frames of PandaSet 001 with the front camera."""
    folder = DATA / "real/pandaset/001"
    camera = folder / "camera/front_camera"
    intrinsics: dict[str, float] = json.loads((camera / "intrinsics.json").read_text())
    focal = np.array([
        [intrinsics["fx"], 0, intrinsics["cx"]], [0, intrinsics["fy"], intrinsics["cy"]], [0, 0, 1]
    ])  # fmt: skip
    poses: list[dict[str, Any]] = json.loads((camera / "poses.json").read_text())
    for number, pose in enumerate(poses[:4]):
        scan = np.load(folder / f"frames/{number:02d}.npz", allow_pickle=False)
        turn = Rotation.from_quat([pose["heading"][axis] for axis in "xyzw"]).as_matrix().T
        place = np.array([pose["position"][axis] for axis in "xyz"])
        matrix = focal @ np.column_stack([turn, -turn @ place])
        kinds = kinds_of(scan["label"], [7, 8, 9, 10, 11, 12], [6])
        yield painted("PandaSet", scan["xyz"], scan["intensity"] / 255, camera / f"{number:02d}.jpg", matrix, kinds)


def amsterdam() -> Iterator[Painted]:
    """Read the two tiles of Amsterdam, which have colours of their own."""
    for path in sorted((DATA / "real/amsterdam_routes/input/pointcloud").glob("*.laz")):
        tile = laspy.read(path)
        rgb = (np.column_stack([tile.red, tile.green, tile.blue]) >> 8).astype(np.uint8)
        xyz, intensity = np.asarray(tile.xyz), np.asarray(tile.intensity, np.float64)
        columns = {"intensity": np.clip(intensity / np.quantile(intensity, 0.995), 0, 1).astype(np.float32), "rgb": rgb}
        cloud = PointCloud(xyz - np.floor(xyz.min(axis=0)), columns, source=path.name)
        yield Painted(f"Amsterdam {path.stem}", cloud, np.full(len(xyz), UNKNOWN, np.int8))


def figures(counts: NDArray[np.int64]) -> str:
    """Return IoU and F1 of natural and paved ground from a confusion matrix: true class, labelled class or another."""
    parts = []
    for name, one in (("natural", NATURAL), ("paved", PAVED)):
        right, union = counts[one, one], counts[one].sum() + counts[:, one].sum() - counts[one, one]
        parts.append(f"{name} IoU {right / max(union, 1):.3f} F1 {2 * right / max(union + right, 1):.3f}")
    return ", ".join(parts)


def main() -> None:
    """Label the recordings and print the figures."""
    arguments = parser(__doc__)
    arguments.add_argument("--model", default="pool")
    options = arguments.parse_args()
    bundle = load_shipped(options.model)
    if ground_classes(bundle.classes) != (PAVED, NATURAL):
        raise SystemExit(f"model {options.model!r} has no classes of paved and natural ground")
    totals: dict[str, dict[str, NDArray[np.int64]]] = defaultdict(dict)
    for read in (semantickitti, kitti_painted, pandaset, amsterdam):
        for recording, cloud, truth in read():
            labels = {"without colour": label_cloud(bundle, cloud.without_columns(["rgb"]))[0]}
            labels["with colour"] = label_cloud(bundle, cloud)[0]
            scored = cloud["rgb"].any(axis=1) & (truth != UNKNOWN)
            for name, found in labels.items():
                if not scored.any():
                    ground = np.isin(found, (PAVED, NATURAL))
                    print(f"{recording}, {name}: {(found[ground] == NATURAL).mean():.3f} of the ground is natural")
                pairs = 3 * truth[scored].astype(int) + np.where(
                    found[scored] > NATURAL, 2, np.maximum(found[scored], 0)
                )
                counts = np.bincount(pairs, minlength=6).reshape(2, 3)
                totals[recording][name] = totals[recording].get(name, np.zeros((2, 3), np.int64)) + counts
    for recording, by_name in totals.items():
        for name, counts in by_name.items():
            if counts.any():
                print(f"{recording}, {name}, {counts[NATURAL].sum()} natural and {counts[PAVED].sum()} paved points: "
                      f"{figures(counts)}")  # fmt: skip


if __name__ == "__main__":
    main()
