"""The images of a survey with their cameras, read when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image as Picture
from PIL import UnidentifiedImageError

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.image_labels.camera import Camera


@dataclass(frozen=True)
class PosedImage:
    """An image that lies in a file, and its camera.

    Parameters
    ----------
    name : str
        Unique in the survey.
    group : str
        Which of the survey's cameras took it, such as ``front_left``.
    time : float
        GPS seconds; NaN where it is not known.
    camera : Camera
        Calibration and pose, for points in world coordinates less `SurveyImages.origin`.
    path : Path
        The picture.
    """

    name: str
    group: str
    time: float
    camera: Camera
    path: Path

    def load(self) -> NDArray[np.uint8]:
        """Read the picture.

        Raises
        ------
        ReadError
            If the file is missing, no picture, or of another size than the camera's images.
        """
        return read_picture(self.path, self.camera, self.name)

    def check(self) -> None:
        """Look whether the picture is there and of the right size, without reading its pixels.

        Raises
        ------
        ReadError
            As `load`.
        """
        with _opened(self.path, self.camera, self.name):
            pass

    def load_labels(self, folder: str) -> NDArray[np.uint8]:
        """Read the label image that lies beside the pictures.

        Raises
        ------
        ReadError
            As `load`.
        """
        path = self.path.parent.parent / folder / f"{self.path.stem}.png"
        with _opened(path, self.camera, self.name) as picture:
            labels: NDArray[np.uint8] = np.asarray(picture).astype(np.uint8)
        return labels


def read_picture(path: str | Path, camera: Camera, name: str) -> NDArray[np.uint8]:
    """Read a picture.

    Raises
    ------
    ReadError
        If the file is missing, no picture, or of another size than the camera's images.
    """
    with _opened(Path(path), camera, name) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.uint8)


@contextmanager
def _opened(path: Path, camera: Camera, name: str) -> Iterator[Picture.Image]:
    """Open a picture of the camera's size; its pixels are read where they are asked for."""
    if not path.is_file():
        raise ReadError(f"{path}: no such picture (image {name!r})")
    try:
        with Picture.open(path) as picture:
            if picture.size != (camera.width, camera.height):
                wide, high = picture.size
                raise ReadError(
                    f"{path}: the picture has {wide} x {high} pixels, its camera is calibrated for "
                    f"{camera.width} x {camera.height}"
                )
            yield picture
    except (UnidentifiedImageError, OSError) as error:
        raise ReadError(f"{path}: cannot be read as a picture: {error}") from error


@dataclass(frozen=True)
class SurveyImages(Sequence[PosedImage]):
    """All images of a survey, in the order of time.

    Parameters
    ----------
    images : tuple of PosedImage
        Empty where the survey has no images.
    origin : ndarray of shape (3,), float64
        World coordinates that the cameras' poses are relative to, metres.
    source : str
        The file that describes them.
    """

    images: tuple[PosedImage, ...]
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    source: str = "survey without images"

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
        """Names of the cameras, in the order of the alphabet."""
        return tuple(sorted({image.group for image in self.images}))

    def relative_to(self, origin: ArrayLike) -> SurveyImages:
        """Return the images with cameras for points relative to another origin."""
        zero = np.asarray(origin, dtype=np.float64)
        moved = tuple(
            PosedImage(i.name, i.group, i.time, i.camera.shifted(zero - self.origin), i.path) for i in self.images
        )
        return SurveyImages(moved, zero, self.source)
