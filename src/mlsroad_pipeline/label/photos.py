"""Photos of the objects of an inventory: the crop of one image each, with the outline of the object."""

import io
import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from mlsroad_pipeline.algorithms.cameras.projection import project_points
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.scene_key import SceneKey
from mlsroad_pipeline.algorithms.inventory.objects.boxes import convex_hull
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.formats.files import atomic_file
from mlsroad_pipeline.inventory_files.qgis_styles import COLOURS
from mlsroad_pipeline.inventory_files.vector_files import without_formulas
from mlsroad_pipeline.surveys.images import PosedImage, SurveyImages

logger = logging.getLogger(__name__)

FOLDER, TABLE = "photos", "photos/photos.csv"
"""Folder of the photos below the output, and the table of them in it."""

REACH = 40.0
"""Largest distance of a camera from an object on its photo, metres."""

LEAST_SHARE = 0.6
"""Smallest share of the corners of an object that lie in the image."""

MARGIN, LEAST_SIDE, LARGEST_SIDE = 0.35, 96, 800
"""Context around the outline as a share of its longer side; smallest and largest side of a photo, pixels."""

QUALITY = 88
COLUMNS = ("object_id", "photo", "image", "camera", "distance", "share_in_image")


class View(NamedTuple):
    """Image of an object."""

    image: int  # Number of the image
    outline: NDArray[np.float64]  # Convex outline of the object, pixels
    share: float  # Share of its corners in the image
    distance: float  # Distance of the camera from its middle, metres
    # Seconds between the image and the times of the object's points, 0 within them or where times are unknown
    late: float

    @property
    def rank(self) -> tuple[float, float, float]:
        """Order of preference: the whole object, at the time of its points, from near."""
        return self.share, -self.late, -self.distance


def corners_of(row: Mapping[str, object]) -> NDArray[np.float64]:
    """Return the corners of an object: its footprint, or the box of its points, at its lowest and highest point."""
    low, high = ([float(str(row[f"{axis}_{end}"])) for axis in "xyz"] for end in ("min", "max"))
    plan = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    if row["footprint"]:
        plan = shapely.get_coordinates(shapely.from_wkt(str(row["footprint"])))[:-1]
    ends = [np.column_stack([plan, np.full(len(plan), z)]) for z in (low[2], high[2])]
    return np.concatenate(ends)


def best_view(
    corners: NDArray[np.float64], images: SurveyImages, near: Sequence[int], times: tuple[float, float]
) -> View | None:
    """Return the view that has the whole object, else most of it, by time and distance; None without any.

    `times` are the first and last time of its points: at another time a vehicle may have moved. What stands between
    camera and object is not tested.
    """
    local = corners - images.origin
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    best: View | None = None
    for number in sorted(near):
        camera = images[number].camera
        pixels, _, inside = project_points(np.vstack([local, middle]), camera)
        share = float(inside[:-1].mean())
        if not inside[-1] or share < LEAST_SHARE or np.isnan(pixels).any():
            continue
        wait = np.nanmax([times[0] - images[number].time, images[number].time - times[1] - 1.0, 0.0])
        view = View(number, pixels[:-1], share, float(np.linalg.norm(camera.centre - middle)), float(wait))
        if best is None or view.rank > best.rank:
            best = view
    return None if best is None else best._replace(outline=convex_hull(best.outline))


def _views(objects: pd.DataFrame, images: SurveyImages) -> dict[int, View]:
    """Return the best view of each object that an image shows, by its number."""
    tree = cKDTree([image.camera.centre for image in images])
    views = {}
    for row in objects.to_dict("records"):
        corners = corners_of({str(name): value for name, value in row.items()})
        near = tree.query_ball_point(corners.mean(axis=0) - images.origin, REACH)
        view = best_view(corners, images, near, (row["first_time"], row["last_time"]))
        if view is not None:
            views[int(row["object_id"])] = view
    return views


def crop(picture: NDArray[np.uint8], outline: NDArray[np.float64], colour: tuple[int, ...]) -> bytes:
    """Return the JPEG of the part of a picture around an outline, with the outline drawn."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, side = (low + high) / 2, (high - low).max() * (1 + 2 * MARGIN)
    half = max(side, LEAST_SIDE) / 2
    size = np.array(picture.shape[1::-1])
    first = np.clip(np.floor(middle - half), 0, size - 1).astype(int)
    last = np.clip(np.ceil(middle + half), first + 1, size).astype(int)
    part = Image.fromarray(picture[first[1] : last[1], first[0] : last[0]])
    scale = min(1.0, LARGEST_SIDE / max(part.size))
    if scale < 1.0:
        part = part.resize((max(1, round(part.width * scale)), max(1, round(part.height * scale))))
    line = [(float(x), float(y)) for x, y in (np.vstack([outline, outline[:1]]) + 0.5 - first) * scale]
    ImageDraw.Draw(part).line(line, fill=colour, width=2, joint="curve")
    written = io.BytesIO()
    part.save(written, "JPEG", quality=QUALITY)
    return written.getvalue()


def _photos(objects: pd.DataFrame, images: SurveyImages) -> Iterator[tuple[dict[str, object], bytes]]:
    """Yield the line of the table and the JPEG of each photo; an image is read once."""
    kinds = dict(zip(objects["object_id"], objects["kind"], strict=True))
    views = _views(objects, images)
    for image in sorted({view.image for view in views.values()}):
        posed: PosedImage = images[image]
        try:
            picture = posed.load()
        except ReadError as error:  # the labels and objects do not depend on it
            logger.warning("%s: there are no photos from it", error)
            continue
        for number, view in views.items():
            if view.image == image:
                colour = tuple(int(part) for part in COLOURS[kinds[number]].split(","))
                line = (number, f"{number}.jpg", posed.name, posed.group, round(view.distance, 2), round(view.share, 2))
                yield dict(zip(COLUMNS, line, strict=True)), crop(picture, view.outline, colour)


def write_photos(objects: pd.DataFrame, passes: Mapping[str, SurveyImages], run: RunFolder) -> str:
    """Write the photos of the objects of all passes with images, and return the path of their table."""
    folder = run.staged(run.output / FOLDER / "photo").parent
    folder.mkdir(parents=True, exist_ok=True)
    lines: list[dict[str, object]] = []
    keys = objects["scene"].map(lambda scene: SceneKey.parse(scene).parent)
    for name, images in passes.items():
        for line, content in _photos(objects[keys == name], images):
            _write(folder / str(line["photo"]), content)
            run.publish(folder / str(line["photo"]))
            lines.append(line)
    table = pd.DataFrame(lines, columns=list(COLUMNS)).sort_values("object_id")
    _write(folder / Path(TABLE).name, without_formulas(table).to_csv(index=False, lineterminator="\n").encode())
    logger.info("Photos of %d of %d objects", len(table), len(objects))
    return str(run.publish(folder / Path(TABLE).name))


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path) as stream:
        stream.write(content)
