"""Reader of camera calibrations and poses: JSON, CSV tables and KITTI files."""

import json
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import LARGEST, Camera
from mlsroad_pipeline.algorithms.cameras.poses import PoseTrack, rotation_of
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened
from mlsroad_pipeline.formats.files import WRONG, named_errors
from mlsroad_pipeline.surveys.images import PICTURES, PosedImage, SurveyImages, picture_size

_SUFFIXES = ("", *PICTURES)
_PERSPECTIVE = {
    *("pinhole", "perspective", "brown", "brownconrady", "conradybrown", "opencv", "fullopencv", "plumbbob", "radtan"),
    *("simplepinhole", "frame", "planar", "rectilinear", "radialtangential"),
}
"""Names of the projection that `Camera` has, in lower case without signs."""
_LENS = ("k1", "k2", "p1", "p2", "k3")
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def read_images(
    path: str | Path, *, images: str | Path | None = None, trajectory: str | Path | None = None
) -> SurveyImages:
    """Read the images of a survey with calibrations and poses.

    Integer pixel coordinates are pixel centres in all three formats.
    """
    source = Path(path)
    if not source.exists():
        raise ReadError(f"{source}: no such camera calibration")
    with named_errors(source, "a file of cameras and poses"):
        return _read_images(source, images, trajectory)


def _read_images(source: Path, images: str | Path | None, trajectory: str | Path | None) -> SurveyImages:
    folder = Path(images) if images is not None else (source if source.is_dir() else source.parent) / "images"
    if source.is_dir() or source.suffix == ".txt":
        return read_kitti(source if source.is_dir() else source.parent)
    if source.suffix == ".json":
        rows, origin = _json_rows(source)
        make: Callable[[Mapping[str, Any]], tuple[Camera, bool]] = _camera_of_json
    elif source.suffix == ".csv":
        rows, origin, make = _table_rows(source), np.zeros(3), _camera_of_row
    else:
        raise ReadError(f"{source}: cameras are read from .json, .csv or KITTI's calib.txt, not {source.suffix!r}")
    images_read = [_posed(source, row, make, folder) for row in rows]
    names = [image.name for image, _ in images_read]
    repeated = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if repeated:
        raise ReadError(f"{source}: image {repeated[0]!r} occurs more than once")
    placed = _georeferenced(images_read, trajectory, source, origin)
    ordered = sorted(placed, key=lambda image: (image.time, image.name))
    return SurveyImages(tuple(ordered), origin, str(source))


def read_poses(path: str | Path, *, max_gap: float = 1.0) -> PoseTrack:
    """Read time-stamped poses of a vehicle from a table."""
    source = Path(path)
    with named_errors(source, "a table of poses"):
        return _read_poses(source, max_gap)


def _read_poses(source: Path, max_gap: float) -> PoseTrack:
    table = _read_table(source, ("gps_time", "x", "y", "z"))
    time, xyz = table["gps_time"].to_numpy(float), table[["x", "y", "z"]].to_numpy(float)
    if {"qw", "qx", "qy", "qz"} <= set(table.columns):
        quaternions = table[["qw", "qx", "qy", "qz"]].to_numpy(float)
        return PoseTrack.from_quaternions(time, xyz, quaternions, max_gap=max_gap, source=str(source))
    _need(source, table, ("roll", "pitch", "heading"))
    angles = table[["roll", "pitch", "heading"]].to_numpy(float)
    return PoseTrack.from_angles(time, xyz, angles, max_gap=max_gap, source=str(source))


def read_kitti(folder: str | Path, *, camera: int = 2) -> SurveyImages:
    """Read one camera of a KITTI sequence."""
    root = Path(folder)
    matrices = _kitti_matrices(root / "calib.txt")
    projection = _matrix(root, matrices, f"P{camera}")
    to_camera = np.eye(4)
    if "Tr" in matrices:
        to_camera[:3] = _matrix(root, matrices, "Tr")
    else:
        to_camera[:3] = _matrix(root, matrices, "Tr_velo_to_cam")
        to_camera[:3] = _matrix(root, matrices, "R0_rect", 3) @ to_camera[:3]
    pictures = sorted((root / f"image_{camera}").glob("*.png"))
    if not pictures:
        raise ReadError(f"{root / f'image_{camera}'}: no pictures")
    poses, times = np.tile(np.eye(4), (len(pictures), 1, 1)), np.full(len(pictures), np.nan)
    if (root / "poses.txt").is_file():
        poses[:, :3] = _numbers(root / "poses.txt", 12, len(pictures)).reshape(-1, 3, 4)
    if (root / "times.txt").is_file():
        times = _numbers(root / "times.txt", 1, len(pictures)).ravel()
    width, height = picture_size(pictures[0])
    matrix = projection[:, :3]
    aside = np.linalg.solve(matrix, projection[:, 3])
    images = []
    for path, pose, time in zip(pictures, poses, times, strict=True):
        extrinsic = np.linalg.inv(pose) @ to_camera
        view = Camera(matrix, np.zeros(5), extrinsic[:3, :3], extrinsic[:3, 3] + aside, width, height)
        images.append(PosedImage(path.stem, f"image_{camera}", float(time), view, path))
    return SurveyImages(tuple(images), np.zeros(3), str(root))


def _json_rows(source: Path) -> tuple[list[dict[str, Any]], NDArray[np.float64]]:
    try:
        document = json.loads(source.read_text(encoding="utf-8"))
    except (ValueError, UnicodeDecodeError) as error:
        raise ReadError(f"{source}: not JSON: {error}") from error
    if not isinstance(document, dict) or not isinstance(document.get("images"), list):
        raise ReadError(f"{source}: has no list 'images'")
    cameras, origin = document.get("cameras", {}), document.get("origin", (0.0, 0.0, 0.0))
    if not isinstance(cameras, dict):
        raise ReadError(f"{source}: cameras is {_short(cameras)}, not a calibration by name")
    rows = []
    for number, row in enumerate(document["images"]):
        if not isinstance(row, dict):
            raise ReadError(f"{source}: image {number} is {_short(row)}, not an object with name and camera")
        shared = cameras.get(str(row.get("camera")), {})
        if not isinstance(shared, dict):
            raise ReadError(f"{source}: camera {row['camera']!r} is {_short(shared)}, not a calibration")
        rows.append({**shared, **row, "mounted": "R" not in row})
    return rows, _origin(origin, source)


def _origin(value: Any, source: Path) -> NDArray[np.float64]:
    try:
        origin = np.asarray(value, dtype=np.float64)
        if origin.shape == (3,) and (np.abs(origin) < LARGEST).all():
            return origin
    except (ValueError, TypeError):
        pass
    raise ReadError(f"{source}: origin is {_short(value)}, not three numbers")


def _short(value: object) -> str:
    return shortened(" ".join(repr(value).split()))


def _time(row: Mapping[str, Any], name: str, source: Path) -> float:
    value = row.get("gps_time", np.nan)
    try:
        return float("nan" if value is None else value)
    except (ValueError, TypeError):
        raise ReadError(f"{source}: image {name!r}: gps_time is {_short(value)}, not a number") from None


def _check_model(row: Mapping[str, Any]) -> None:
    """Raise ReadError for a projection other than the perspective one with the lens of Brown and Conrady."""
    for key in ("model", "camera_model", "projection", "lens_model"):
        name = row.get(key)
        if isinstance(name, str) and name.strip() and re.sub(r"[\W_]+", "", name).lower() not in _PERSPECTIVE:
            raise ReadError(
                f"{key} {name!r} is not supported: give images of a perspective camera with k1, k2, p1, p2, k3 "
                "(OpenCV's default), rectified from fisheye images or panoramas"
            )


def _camera_of_json(row: Mapping[str, Any]) -> tuple[Camera, bool]:
    lens = row.get("distortion")
    camera = Camera(
        row["K"], np.zeros(5) if lens is None else np.asarray(lens), row["R"], row["t"], row["width"], row["height"]
    )
    return camera, bool(row["mounted"])


def _read_table(source: Path, columns: Sequence[str]) -> pd.DataFrame:
    if not source.is_file():
        raise ReadError(f"{source}: no such table")
    try:
        table = pd.read_csv(source, skipinitialspace=True)
    except (ValueError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise ReadError(f"{source}: not a table of comma-separated values: {error}") from error
    _need(source, table, columns)
    return table


def _need(source: Path, table: pd.DataFrame, columns: Sequence[str]) -> None:
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise ReadError(f"{source}: no column {missing[0]!r} among {list(table.columns)}")


def _table_rows(source: Path) -> list[dict[str, Any]]:
    table = _read_table(source, ("name", "camera", "gps_time", "fx", "fy", "cx", "cy", "width", "height"))
    mounted = not set(_POSE) <= set(table.columns)
    if mounted:
        _need(source, table, [f"mount_{name}" for name in _POSE])
    rows = [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]
    return [{**row, "mounted": mounted} for row in rows]


def _camera_of_row(row: Mapping[str, Any]) -> tuple[Camera, bool]:
    before = "mount_" if row["mounted"] else ""
    pose = np.array([row[f"{before}{name}"] for name in _POSE], dtype=np.float64)
    rotation = rotation_of(pose[None, 3:]).as_matrix()[0].T
    matrix = np.array([[row["fx"], 0, row["cx"]], [0, row["fy"], row["cy"]], [0, 0, 1.0]])
    lens = np.array([row.get(name, 0.0) for name in _LENS])
    return Camera(matrix, lens, rotation, -rotation @ pose[:3], row["width"], row["height"]), bool(row["mounted"])


def _posed(
    source: Path, row: Mapping[str, Any], make: Callable[[Mapping[str, Any]], tuple[Camera, bool]], folder: Path
) -> tuple[PosedImage, bool]:
    name, group = str(row.get("name")), str(row.get("camera"))
    try:
        _check_model(row)
        camera, mounted = make(row)
    except KeyError as error:
        raise ReadError(f"{source}: camera {group!r} of image {name!r} has no calibration: no {error}") from error
    except (MlsRoadError, *WRONG) as error:
        raise ReadError(f"{source}: image {name!r}: {' '.join(str(error).split())}") from error
    path = next((p for s in _SUFFIXES if (p := folder / f"{name}{s}").is_file()), folder / name)
    return PosedImage(name, group, _time(row, name, source), camera, path), mounted


def _georeferenced(
    images: list[tuple[PosedImage, bool]], trajectory: str | Path | None, source: Path, origin: NDArray[np.float64]
) -> list[PosedImage]:
    """Return the images with world poses; the poses of mounted cameras follow from the trajectory."""
    mounted = [image for image, on_vehicle in images if on_vehicle]
    if mounted and trajectory is None:
        raise ReadError(f"{source}: image {mounted[0].name!r} has no pose, and there is no trajectory with poses")
    fixed = [image for image, on_vehicle in images if not on_vehicle]
    if not mounted or trajectory is None:
        return fixed
    rotations, places = read_poses(trajectory).at([image.time for image in mounted])
    for image, rotation, place in zip(mounted, rotations, places - origin, strict=True):
        fixed.append(PosedImage(image.name, image.group, image.time, image.camera.carried(rotation, place), image.path))
    return fixed


def _kitti_matrices(path: Path) -> dict[str, list[float]]:
    if not path.is_file():
        raise ReadError(f"{path}: no such camera calibration")
    matrices = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        name, _, values = line.partition(":")
        if not values.strip():
            continue
        try:
            matrices[name.strip()] = [float(word) for word in values.split()]
        except ValueError as error:
            raise ReadError(f"{path}: line {number}: {error}") from error
    return matrices


def _matrix(root: Path, matrices: Mapping[str, list[float]], name: str, columns: int = 4) -> NDArray[np.float64]:
    values = matrices.get(name)
    if values is None or len(values) != 3 * columns:
        count = "is missing" if values is None else f"has {len(values)} values, not {3 * columns}"
        raise ReadError(f"{root / 'calib.txt'}: {name} {count} (found: {', '.join(matrices)})")
    return np.array(values).reshape(3, columns)


def _numbers(path: Path, columns: int, rows: int) -> NDArray[np.float64]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a file without numbers
            values = np.loadtxt(path, ndmin=2)
    except (ValueError, UserWarning) as error:
        raise ReadError(f"{path}: {error}") from error
    if values.shape != (rows, columns):
        raise ReadError(f"{path}: {values.shape[0]} rows of {values.shape[1]} values for {rows} pictures")
    return values
