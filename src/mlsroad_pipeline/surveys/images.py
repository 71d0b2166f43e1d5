"""Images of a survey with their cameras; pictures are loaded on demand."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image as Picture
from PIL import UnidentifiedImageError

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
"""Suffixes of pictures, which the name of an image may lack."""


@dataclass(frozen=True)
class PosedImage:
    """Image file with camera calibration and pose."""

    name: str  # Unique in the survey; it may have folders, such as ``front/0001``
    group: str  # Name of the camera, such as ``front_left``
    time: float  # GPS seconds; NaN if unknown
    camera: Camera  # Calibration and pose, for points in world coordinates less `SurveyImages.origin`
    path: Path  # Picture file

    @property
    def root(self) -> Path:
        """Folder of the pictures, from which the name of the image starts."""
        name = Path(self.name)
        return self.path.parent if name.is_absolute() else self.path.parents[max(len(name.parts), 1) - 1]

    def load(self) -> NDArray[np.uint8]:
        """Return the picture."""
        return read_picture(self.path, self.camera, self.name)

    def check(self) -> None:
        """Check that the picture exists and has the calibrated size, without loading its pixels."""
        with opened_picture(self.path, self.camera, self.name):
            pass

    def load_labels(self, folder: str) -> NDArray[np.uint8]:
        """Return the label image from a folder beside the pictures."""
        path = self.root.parent / folder / self.path.relative_to(self.root).with_suffix(".png")
        with opened_picture(path, self.camera, self.name) as picture:
            labels: NDArray[np.uint8] = np.asarray(picture).astype(np.uint8)
        return labels


def read_picture(path: str | Path, camera: Camera, name: str) -> NDArray[np.uint8]:
    """Return a picture as RGB."""
    with opened_picture(Path(path), camera, name) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.uint8)


_DAMAGED = (
    UnidentifiedImageError, OSError, EOFError, ValueError, SyntaxError, struct.error, zlib.error,
    Picture.DecompressionBombError,
)  # fmt: skip
"""Errors of Pillow for damaged files, and for more than 179 million pixels."""


@contextmanager
def opened_picture(path: Path, camera: Camera, name: str) -> Iterator[Picture.Image]:
    """Open a picture and check its size; pixels are loaded on access."""
    if not path.is_file():
        raise ReadError(f"{path}: no such picture (image {name!r})")
    with _readable(path) as picture:
        if picture.size != (camera.width, camera.height):
            wide, high = picture.size
            raise ReadError(
                f"{path}: the picture has {wide} x {high} pixels, the calibration is for "
                f"{camera.width} x {camera.height}"
            )
        yield picture


def picture_size(path: Path) -> tuple[int, int]:
    """Return width and height of a picture, without its pixels."""
    with _readable(path) as picture:
        return picture.size


@contextmanager
def _readable(path: Path) -> Iterator[Picture.Image]:
    try:
        with Picture.open(path) as picture:
            yield picture
    except MlsRoadError:
        raise
    except _DAMAGED as error:
        raise ReadError(f"{path}: cannot be read as a picture: {shortened(printable(error), 200)}") from error


@dataclass(frozen=True)
class SurveyImages(Sequence[PosedImage]):
    """Images of a survey in the order of time."""

    images: tuple[PosedImage, ...]  # Images; empty for a survey without images
    # World coordinates that the cameras' poses are relative to, metres
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    source: str = "survey without images"  # File with the calibration

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.images)

    def __getitem__(self, index: Any) -> Any:
        """Return an image, or a tuple of them for a slice."""
        return self.images[index]

    def __iter__(self) -> Iterator[PosedImage]:
        """Yield the images."""
        return iter(self.images)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the cameras, sorted."""
        return tuple(sorted({image.group for image in self.images}))

    def relative_to(self, origin: ArrayLike) -> SurveyImages:
        """Return the images with camera poses relative to another origin."""
        zero = np.asarray(origin, dtype=np.float64)
        moved = tuple(
            PosedImage(i.name, i.group, i.time, i.camera.shifted(zero - self.origin), i.path) for i in self.images
        )
        return SurveyImages(moved, zero, self.source)
