"""Segmented images in files, class numbers (PNG) or probabilities (NPZ), and their class maps."""

import csv
import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.cameras.camera import Camera
from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.surveys.images import PICTURES, PosedImage, SurveyImages, opened_picture

OF_SCHEME = "scheme"
"""Name of the map of a network of this package: the classes of the scheme, then the sky."""


def read_class_map(given: str, scheme: ClassScheme) -> Legend:
    """Return the legend of a shipped class map, of a CSV or YAML file, or of the scheme itself."""
    if given == OF_SCHEME:
        return Legend.of_scheme(scheme)
    shipped = files("mlsroad_pipeline.surveys").joinpath("class_maps", f"{given}.csv")
    if "/" not in given and shipped.is_file():
        return _legend(_csv_rows(shipped.read_text(encoding="utf-8"), given), given, scheme)
    path = Path(given).expanduser()
    if path.suffix.lower() not in (".csv", ".yml", ".yaml"):
        raise ReadError(f"image_labels.classes is {given!r}: name cityscapes, scheme, or a file .csv or .yml")
    if not path.is_file():
        raise ReadError(f"{path}: no such class map (image_labels.classes)")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ReadError(f"{path}: cannot be read as a class map: {error}") from error
    rows = _csv_rows(text, str(path)) if path.suffix.lower() == ".csv" else _yaml_rows(text, str(path))
    return _legend(rows, str(path), scheme)


def _legend(rows: list[tuple[Any, Any, Any]], source: str, scheme: ClassScheme) -> Legend:
    checked = []
    for number, name, target in rows:
        try:
            value = int(str(number))
        except ValueError:
            raise ReadError(f"{source}: class number {number!r} is not a whole number") from None
        text = "" if target is None else str(target).strip()
        checked.append((value, str(name or text or value).strip(), text or None))
    legend = Legend.of_rows(checked, source)
    legend.labels(scheme)  # every class is known
    return legend


def _csv_rows(text: str, source: str) -> list[tuple[Any, Any, Any]]:
    table = csv.DictReader(text.splitlines(), skipinitialspace=True)
    columns = [name.strip() for name in table.fieldnames or []]
    for needed in ("number", "class"):
        if needed not in columns:
            raise ReadError(f"{source}: no column {needed!r} among {columns}; a class map has number, name, class")
    table.fieldnames = columns
    rows = []
    for row in table:
        if row["class"] is None or None in row:
            raise ReadError(f"{source}: line {table.line_num} has not the {len(columns)} columns {', '.join(columns)}")
        rows.append((row["number"], row.get("name"), row["class"]))
    return rows


def _yaml_rows(text: str, source: str) -> list[tuple[Any, Any, Any]]:
    try:
        keys, given = _keys_and_content(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ReadError(f"{source}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(given, dict):
        raise ReadError(f"{source}: must map class numbers to classes, such as `0: road`, not {given!r:.60}")
    repeated = next((key for k, key in enumerate(keys) if key in keys[:k]), None)
    if repeated is not None:
        raise ReadError(f"{source}: class number {repeated} is repeated")
    rows = []
    for number, value in given.items():
        if isinstance(value, dict) and set(value) <= {"name", "class"}:
            rows.append((number, value.get("name"), value.get("class")))
        elif value is None or isinstance(value, str):
            rows.append((number, value, value))
        else:
            raise ReadError(f"{source}: class number {number} has {value!r:.60}, not a class or {{name, class}}")
    return rows


def _keys_and_content(text: str) -> tuple[list[Any], Any]:
    """Return the keys of a YAML mapping, of which PyYAML keeps the last of equal ones, and its content."""
    loader = yaml.SafeLoader(text)
    node = loader.get_single_node()
    if not isinstance(node, yaml.MappingNode):
        return [], None if node is None else loader.construct_document(node)
    keys = [loader.construct_object(key) for key, _ in node.value if key.tag != "tag:yaml.org,2002:merge"]
    return keys, loader.construct_document(node)


SUFFIXES = (".npz", ".png")
PROBABILITIES = "probabilities"
"""Array of an NPZ mask."""

_MODES = ("L", "P", "I;16", "I;16B", "I")
_TOLERANCE = 0.01
_HEADER = 26
"""Bytes of a PNG up to its bit depth and colour type."""
_DAMAGED = (
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
    except _DAMAGED as error:
        raise _no_npz(path, error) from error
    size = (camera.height, camera.width)
    if dtype.kind != "f" or len(shape) != 3 or size not in (shape[:2], shape[1:]):
        raise ReadError(
            f"{path}: {PROBABILITIES} are {dtype} of shape {shape}; they must be floats of shape ({camera.height}, "
            f"{camera.width}, classes) for the calibration of {camera.width} x {camera.height}"
        )
    return shape


def _no_npz(path: Path, error: Exception) -> ReadError:
    return ReadError(f"{path}: cannot be read as NPZ: {type(error).__name__}: {printable(error)[:200]}")


def _probabilities(path: Path, camera: Camera) -> NDArray[np.floating]:
    shape = _shape_of(path, camera)
    try:
        with np.load(path, allow_pickle=False) as archive:
            values: NDArray[np.floating] = archive[PROBABILITIES]
    except _DAMAGED as error:
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
