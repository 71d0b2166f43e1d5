"""Pictures of a whole survey, one scene and single objects, from above and from the side."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mlsroad_pipeline.algorithms.core.palette import MISSED_COLOUR, WRONG_COLOUR
from mlsroad_pipeline.reporting.clouds.splatting import render_points
from mlsroad_pipeline.reporting.clouds.view import View, birds_eye_view, main_azimuth

WIDEST = 1400
"""Width of the picture of a survey, pixels."""
FINEST = 0.15
"""Smallest pixel of the picture of a survey, metres."""
_TURN_GAIN = 0.75  # a map is turned where that makes its frame smaller than this share
_MARGIN = 3.0  # around the survey, metres
_TRIM = 0.002  # share of points outside of the frame at each side
_SCENE_SIZE = (1100, 460)


class MapFrame(NamedTuple):
    """Frame of a map in metres: its x axis (`right`), its y axis upwards (`up`), lower left corner and size."""

    # right, up: axes of the map in world coordinates
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    low: NDArray[np.float64]  # Corner along the axes, metres
    size: NDArray[np.float64]  # Width and height, metres

    def place(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions on the map: to the right, and down from its top."""
        along = np.asarray(xy, dtype=np.float64) @ np.column_stack([self.right, self.up]) - self.low
        return np.column_stack([along[:, 0], self.size[1] - along[:, 1]])

    @property
    def north(self) -> float:
        """Direction of grid north on the map, degrees clockwise from its top."""
        return float(np.degrees(np.arctan2(self.right[1], self.up[1])))


def map_frame(points: NDArray[np.float64], shown: NDArray[np.float64]) -> MapFrame:
    """Return the frame of a map: north up, or turned along the survey where that is clearly smaller."""
    every = np.concatenate([points, shown])
    if not len(every):
        return _frame(0.0, np.zeros((1, 2)), np.zeros((0, 2)))
    turn = main_azimuth(np.column_stack([every - every.mean(axis=0), np.zeros(len(every))]))
    upright, turned = (_frame(angle, points, shown) for angle in (0.0, turn))
    return turned if np.prod(turned.size) < _TURN_GAIN * np.prod(upright.size) else upright


def _frame(angle: float, points: NDArray[np.float64], shown: NDArray[np.float64]) -> MapFrame:
    turn = np.radians(angle)
    right, up = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    axes = np.column_stack([right, up])
    limits = [np.quantile(points @ axes, [_TRIM, 1 - _TRIM], axis=0)] if len(points) else []
    limits += [shown @ axes] if len(shown) else []
    every = np.concatenate(limits)
    low = every.min(axis=0) - _MARGIN
    return MapFrame(right, up, low, every.max(axis=0) + _MARGIN - low)


def overview_picture(
    parts: Iterable[tuple[NDArray[np.float64], NDArray[np.integer]]], palette: NDArray[np.uint8], frame: MapFrame
) -> NDArray[np.uint8]:
    """Return the classes of the highest points in each pixel of a map; white where there is none."""
    pixel = max(float(frame.size.max()) / WIDEST, FINEST)
    columns, rows = (int(np.ceil(side / pixel)) for side in frame.size)
    top, label = np.full(rows * columns, -np.inf), np.full(rows * columns, -2, dtype=np.int16)
    for xyz, own in parts:
        cell = np.floor(frame.place(xyz[:, :2]) / pixel).astype(np.int64)
        inside = np.flatnonzero(((cell >= 0) & (cell < [columns, rows])).all(axis=1))
        inside = inside[np.argsort(xyz[inside, 2], kind="stable")]
        key = cell[inside, 1] * columns + cell[inside, 0]
        last = len(key) - 1 - np.unique(key[::-1], return_index=True)[1]  # the highest point of each pixel
        higher = last[xyz[inside[last], 2] > top[key[last]]]
        top[key[higher]], label[key[higher]] = xyz[inside[higher], 2], own[inside[higher]]
    return _painted(label.reshape(rows, columns), palette)


def _painted(label: NDArray[np.int16], palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the picture of labels; empty pixels between filled ones take the label of a neighbour."""
    padded = np.pad(label, 1, constant_values=-2)
    filled = label.copy()
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        other = padded[1 + down : 1 + down + label.shape[0], 1 + right : 1 + right + label.shape[1]]
        filled = np.where(filled == -2, other, filled)
    colours = np.concatenate([palette, np.full((1, 3), 255, np.uint8)])
    return colours[np.where(filled == -2, len(palette), np.where(filled < 0, len(palette) - 1, filled))]


def scene_pictures(
    xyz: NDArray[np.float64], label: NDArray[np.integer], palette: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a scene from above, and its left half from the middle to the side, with its long side horizontal."""
    middle = np.median(xyz, axis=0)
    points, colours = (xyz - middle).astype(np.float32), palette[label]
    azimuth = main_azimuth(points)
    width, height = _SCENE_SIZE
    above = birds_eye_view(points, width=width, azimuth=azimuth, trim=0.002)
    if above.size[1] > height:
        above = birds_eye_view(points, width=width, height=height, azimuth=azimuth, trim=0.002)
    turn = np.radians(azimuth)
    outward = np.array([-np.sin(turn), np.cos(turn), 0.0])
    beyond = points[:, :2] @ outward[:2] >= 0
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    rotation = np.stack([right, [0.0, 0.0, -1.0], outward])
    half = points[beyond]
    along, up = np.quantile(half @ right, [0.002, 0.998]), np.quantile(half[:, 2], [0.002, 0.998])
    scale = float(min(width / max(np.ptp(along), 1.0), height / max(np.ptp(up), 1.0)) / 1.04)
    centre = right * along.mean() + np.array([0.0, 0.0, up.mean()])
    side = View(rotation, centre, scale, (width, int(np.clip(scale * np.ptp(up) * 1.06, 120, height))), False)
    return (
        render_points(points, colours, above, splat_metres=0.1, oversampling=1),
        render_points(half, colours[beyond], side, splat_metres=0.1, oversampling=1),
    )


SIDE = 240
"""Side of each of the two views, pixels."""
_ABOVE = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
_NORTHWARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_GAP = 4


def object_picture(
    xyz: NDArray[np.floating],
    colours: NDArray[np.uint8],
    *,
    reach: float,
    bottom: float,
    listed: bool = True,
    true: tuple[float, float] | None = None,
) -> NDArray[np.uint8]:
    """Return the points around an object, from above (north up) and from the south, side by side.

    Coordinates are relative to the object in plan. A red cross marks the listed object, a blue circle the true one
    (`true`, relative too).
    """
    views = []
    high = float(xyz[:, 2].max()) + 1.0 if len(xyz) else 1.0
    middle = bottom + 0.7 * reach
    for rotation, centre in ((_ABOVE, (0.0, 0.0, high)), (_NORTHWARD, (0.0, -reach, middle))):
        view = View(rotation, np.array(centre), SIDE / (2 * reach), (SIDE, SIDE), False)
        picture = (
            render_points(xyz, colours, view, splat_metres=max(0.05, reach / 80), oversampling=1)
            if len(xyz)
            else np.full((SIDE, SIDE, 3), 255, np.uint8)
        )
        views.append(_marked(picture, view, bottom, listed, true))
    return np.concatenate([views[0], np.full((SIDE, _GAP, 3), 255, np.uint8), views[1]], axis=1)


def _marked(
    picture: NDArray[np.uint8], view: View, bottom: float, listed: bool, true: tuple[float, float] | None
) -> NDArray[np.uint8]:
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)

    def pixel(x: float, y: float) -> tuple[float, float]:
        right, down, _ = view.rotation @ (np.array([x, y, bottom]) - view.centre) * view.scale
        return SIDE / 2 + float(right), SIDE / 2 + float(down)

    if true is not None:
        u, v = pixel(*true)
        draw.ellipse((u - 7, v - 7, u + 7, v + 7), outline=MISSED_COLOUR, width=2)
    if listed:
        u, v = pixel(0.0, 0.0)
        draw.line((u - 6, v - 6, u + 6, v + 6), fill=WRONG_COLOUR, width=2)
        draw.line((u - 6, v + 6, u + 6, v - 6), fill=WRONG_COLOUR, width=2)
    draw.rectangle((0, 0, SIDE - 1, SIDE - 1), outline=(200, 204, 212))
    return np.asarray(image)
