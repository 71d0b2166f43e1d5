"""Segmented images in files: class numbers (PNG) or probabilities (NPZ)."""

import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened
from mlsroad_pipeline.surveys.images import PICTURES, PosedImage, SurveyImages, opened_picture

SUFFIXES = (".npz", ".png")
PROBABILITIES = "probabilities"
"""Array of an NPZ mask."""

_MODES = ("L", "P", "I;16", "I;16B", "I")
_TOLERANCE = 0.01
_HEADER = 26
"""Bytes of a PNG up to its bit depth and colour type."""
DAMAGED = (
    OSError, EOFError, ValueError, SyntaxError, RuntimeError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
    struct.error, tokenize.TokenError,
)  # fmt: skip
"""Errors of zipfile and NumPy for damaged or encrypted archives and headers of arrays."""


@dataclass(frozen=True)
class MaskLegend:
    """Class map of masks: number, name and class of points."""

    legend: Legend  # The class map
    scheme: ClassScheme  # The classes of points


def masks_of_passes(passes: Mapping[str, SurveyImages], folder: str) -> dict[str, SurveyImages]:
    """Return the images of passes with masks in place of their pictures, and check the headers of all masks.

    A folder that exists holds the masks of all passes; otherwise it is the name of a folder beside the pictures.
    """
    shared = Path(folder).expanduser().is_dir()
    names: dict[str, str] = {}
    found = {}
    for pass_key, images in passes.items():
        for image in images:
            if shared and names.setdefault(image.name, pass_key) != pass_key:
                raise ReadError(
                    f"{folder}: image {image.name!r} occurs in passes {names[image.name]} and {pass_key}; put the "
                    "masks of each pass into a folder beside its pictures, and name that (image_labels.masks=NAME)"
                )
        found[pass_key] = with_masks(images, folder)
        for image in found[pass_key]:
            check_mask(image.path, image.camera)
    return found


def with_masks(images: SurveyImages, folder: str) -> SurveyImages:
    """Return images whose paths are those of their masks; raise ReadError if two images have the same mask."""
    moved: dict[Path, PosedImage] = {}
    for image in images:
        path = mask_of(masks_folder(image, folder), image.name)
        if path in moved:
            raise ReadError(
                f"{path}: is the mask of both images {moved[path].name!r} and {image.name!r}; name masks as the "
                "images, such as a.jpg.png and a.png.png"
            )
        moved[path] = replace(image, path=path)
    return SurveyImages(tuple(moved.values()), images.origin, images.source)


def masks_folder(image: PosedImage, folder: str) -> Path:
    """Return the folder of the mask of an image: a path that exists, or the name of a folder beside the pictures."""
    named = Path(folder).expanduser()
    return named if named.is_dir() else image.root.parent / folder


def mask_of(folder: Path, name: str) -> Path:
    """Return the mask of an image; its name may or may not have the suffix of the picture."""
    own = Path(name).name if Path(name).is_absolute() else name
    bare = Path(own)
    bare = bare.with_suffix("") if bare.suffix.lower() in PICTURES else bare
    for stem in dict.fromkeys((own, str(bare))):
        for suffix in SUFFIXES:
            if (path := folder / f"{stem}{suffix}").is_file():
                return path
    raise ReadError(f"{folder}: no mask of image {name!r}: neither {bare}.png nor {bare}.npz")


def check_mask(path: Path, camera: Camera) -> None:
    """Check that a mask has the size of its image, without its pixels; raise ReadError."""
    if path.suffix == ".npz":
        _shape_of(path, camera)
        return
    depth = _grey_depth(path)
    if depth < 8:
        raise ReadError(
            f"{path}: the mask is grey of {depth} bits; save the class numbers with 8 or 16 bits, or with a palette"
        )
    with opened_picture(path, camera, path.stem) as picture:
        if picture.mode not in _MODES:
            raise ReadError(
                f"{path}: the mask has colours (mode {picture.mode}); it must have one channel with class numbers"
            )


def read_mask(path: str | Path, camera: Camera, known: MaskLegend) -> NDArray[np.float32]:
    """Return the class probabilities of a mask's pixels, NaN for pixels that give no class."""
    source = Path(path)
    check_mask(source, camera)
    if source.suffix == ".npz":
        scores = _probabilities(source, camera)
        return known.legend.of_scores(scores, known.scheme, source=str(source))
    with opened_picture(source, camera, source.stem) as picture:
        numbers = np.asarray(picture).astype(np.int64)
    return known.legend.of_numbers(numbers, known.scheme, source=str(source))


def _grey_depth(path: Path) -> int:
    """Return the bits of a pixel of a grey PNG, whose numbers Pillow scales below 8 bits; 8 for other files."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEADER)
    except OSError:  # `opened_picture` reports it
        return 8
    is_grey = head.startswith(b"\x89PNG") and len(head) == _HEADER and head[25] in (0, 4)
    return head[24] if is_grey else 8


def _shape_of(path: Path, camera: Camera) -> tuple[int, ...]:
    """Return the shape of the probabilities; only the header is read."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{PROBABILITIES}.npy") as member:
            version = np.lib.format.read_magic(member)
            reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = reader(member)
    except KeyError:
        raise ReadError(f"{path}: holds no array {PROBABILITIES!r}") from None
    except DAMAGED as error:
        raise _no_npz(path, error) from error
    size = (camera.height, camera.width)
    if dtype.kind != "f" or len(shape) != 3 or size not in (shape[:2], shape[1:]):
        raise ReadError(
            f"{path}: {PROBABILITIES} are {dtype} of shape {shape}; they must be floats of shape ({camera.height}, "
            f"{camera.width}, classes) for the calibration of {camera.width} x {camera.height}"
        )
    return shape


def _no_npz(path: Path, error: Exception) -> ReadError:
    return ReadError(f"{path}: cannot be read as NPZ: {type(error).__name__}: {shortened(printable(error), 200)}")


def _probabilities(path: Path, camera: Camera) -> NDArray[np.floating]:
    shape = _shape_of(path, camera)
    try:
        with np.load(path, allow_pickle=False) as archive:
            values: NDArray[np.floating] = archive[PROBABILITIES]
    except DAMAGED as error:
        raise _no_npz(path, error) from error
    if shape[:2] != (camera.height, camera.width):  # channels first
        values = np.moveaxis(values, 0, 2)
    total = values.sum(axis=2, dtype=np.float64)
    wrong = ~(np.abs(total - 1) <= _TOLERANCE) | (values.min(axis=2) < 0)
    if wrong.any():
        row, column = (int(index[0]) for index in np.nonzero(wrong))
        raise ReadError(
            f"{path}: the probabilities of pixel row {row}, column {column} sum to {total[row, column]:.4g} with "
            f"minimum {values[row, column].min():.4g} ({int(wrong.sum())} pixels); they must be >= 0 and sum to 1"
        )
    return values
