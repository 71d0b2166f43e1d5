"""Small pictures of single objects: cut out of the cloud, from above and from the side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mlsroad_pipeline.algorithms.core.palette import MISSED_COLOUR, WRONG_COLOUR
from mlsroad_pipeline.reporting.clouds.splatting import render_points
from mlsroad_pipeline.reporting.clouds.view import View

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
            else _blank()
        )
        views.append(_marked(picture, view, bottom, listed, true))
    return np.concatenate([views[0], np.full((SIDE, _GAP, 3), 255, np.uint8), views[1]], axis=1)


def _blank() -> NDArray[np.uint8]:
    return np.full((SIDE, SIDE, 3), 255, np.uint8)


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
