"""Search for point cloud files below a folder or by glob, and files that hold no points."""

import fnmatch
import logging
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from glob import escape, glob, has_magic
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.formats.base import ReadOptions
from mlsroad_pipeline.formats.files import first_bytes, unpacked_name
from mlsroad_pipeline.formats.las.copc import SUFFIX
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.pcd.header import read_pcd_header
from mlsroad_pipeline.formats.ply.header import read_ply_header
from mlsroad_pipeline.formats.registry import FORMATS, format_of_name, get_format, known_extensions
from mlsroad_pipeline.formats.text.sniffing import holds_rows

logger = logging.getLogger(__name__)


def find_point_files(root: str | Path, patterns: Sequence[str] | None = None) -> list[Path]:
    """Return the point cloud files of a file, a folder or a glob, sorted; hidden files are left out."""
    path = Path(root)
    if path.is_file():
        return [path]
    if path.is_dir():
        matches = [match for pattern in (patterns or ["**/*"]) for match in _matching(path, pattern)]
    elif has_magic(str(root)):
        matches = []
        for entry in _entries(path):
            holds = entry.is_dir() and any(p.is_file() and format_of_name(p) is not None for p in entry.rglob("*"))
            matches += find_point_files(entry) if holds else [entry]
    else:
        raise ReadError(f"{root} does not exist")
    files = _once({m for m in matches if format_of_name(m) is not None and not _hidden(m, path)})
    if not files:
        searched = f"{root} with {', '.join(patterns)}" if patterns else str(root)
        raise ReadError(f"no point cloud found in {searched} (extensions: {', '.join(known_extensions())})")
    return files


def broken_links(root: str | Path) -> list[Path]:
    """Return the links below a folder, or of a glob, that are named as point clouds and lead to no file."""
    path = Path(root)
    if path.is_file():
        return []
    entries = _below(path) if path.is_dir() else _entries(path) if has_magic(str(root)) else ()
    links = (entry for entry in entries if entry.is_symlink() and not os.path.exists(entry))
    return sorted(link for link in links if format_of_name(link) is not None and not _hidden(link, path))


def _matching(folder: Path, pattern: str) -> list[Path]:
    if Path(pattern).is_absolute() or ".." in Path(pattern).parts:
        raise ParameterError(f"pattern {pattern!r} must stay below {folder}")
    if pattern == "**/*":
        return list(_below(folder))
    matches = _entries(Path(escape(str(folder))) / pattern)
    return [p for match in matches for p in (match.rglob("*") if match.is_dir() else [match])]


def _entries(pattern: Path) -> list[Path]:
    """Return the files and folders that a glob names; ``**`` visits each folder once, whatever links lead to it."""
    parts = pattern.parts
    if "**" not in parts:
        return [Path(entry) for entry in glob(str(pattern))]
    at = parts.index("**")
    names = parts[at:] if parts[-1] != "**" else (*parts[at:], "*")
    folders = ("(?:[^/]+/)*" if part == "**" else _segment(part) + "/" for part in names[:-1])
    named_hidden = any(part.startswith(".") for part in parts[at:])
    wanted = re.compile("".join(folders) + _segment(names[-1]))
    found = []
    for base in (entry for entry in glob(str(Path(*parts[:at]) if at else Path("."))) if Path(entry).is_dir()):
        for path in _below(Path(base)):
            below = path.relative_to(base).parts
            if not named_hidden and any(part.startswith(".") for part in below):
                continue
            ends = range(1, len(below) + 1)  # a folder that matches holds the file
            if any(wanted.fullmatch("/".join(below[:end])) for end in ends):
                found.append(path)
    return found


def _segment(name: str) -> str:
    """Return the regular expression of a name of a glob; ``*`` does not cross folders."""
    return fnmatch.translate(name).replace(".*", "[^/]*").removesuffix(r"\Z")


def _below(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, each folder once; links are followed after the folders themselves."""
    folders, links, seen = [folder], list[Path](), set[str]()
    while folders or links:
        here = folders.pop(0) if folders else links.pop(0)
        real = os.path.realpath(here)
        if real in seen or (here != folder and Path(os.path.realpath(here.parent)).is_relative_to(real)):
            continue
        seen.add(real)
        try:
            with os.scandir(here) as found:
                entries = sorted(found, key=lambda entry: entry.name)
        except OSError as error:
            logger.warning("%s cannot be read: %s: skipped", here, error.strerror)
            continue
        for entry in entries:
            if Path(entry.path).is_dir():
                (links if entry.is_symlink() else folders).append(Path(entry.path))
            else:
                yield Path(entry.path)


def _once(paths: Iterable[Path]) -> list[Path]:
    """Return existing files, each once whatever links lead to it; the path without links is kept."""
    found: dict[tuple[int, int], tuple[bool, int, Path]] = {}
    for path in paths:
        if not path.is_file():
            continue
        status = path.stat()
        rank = (os.path.realpath(path) != os.path.abspath(path), len(path.parts), path)
        key = (status.st_dev, status.st_ino)
        found[key] = min(found.get(key, rank), rank)
    return sorted(path for _, _, path in found.values())


def _hidden(path: Path, root: Path) -> bool:
    parts = path.relative_to(root).parts if path.is_relative_to(root) else (path.name,)
    return any(part.startswith(".") for part in parts)


def find_split_files(root: str | Path, split: str, patterns: Sequence[str]) -> list[Path]:
    """Return the point cloud files of a split."""
    if not Path(root).is_dir():
        raise ReadError(f"{root} is not a folder")
    if not patterns:
        raise ParameterError(f"split {split!r} has no patterns")
    try:
        return find_point_files(root, patterns)
    except ReadError as error:
        raise ReadError(f"split {split!r} matches nothing: {error}") from error


SMALL = 1 << 20
"""Largest size in bytes of a file whose number of points is read to find out whether it has any."""

DOCUMENTS = {
    **{b"<": "HTML or XML", b"{": "JSON", b"%PDF": "PDF", b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG"},
    **{b"II*\0": "TIFF", b"MM\0*": "TIFF"},
}
"""First bytes of files that hold no points to their kind. An unknown content is an error: it may be a point cloud."""


def no_points_reason(path: Path, *, text: bool = True) -> str | None:
    """Return why a file holds no points, or None if it may hold some; a damaged point cloud is not left out.

    Text is tested if `text` is true, that is unless the options of the reader describe its delimiter.
    """
    try:
        if path.stat().st_size == 0:
            return "is empty (0 bytes)"
        head = first_bytes(path, 16)
    except (OSError, ReadError):
        return None  # reading it gives the error
    named = format_of_name(path)
    held = next((form for form in FORMATS if form.recognises(path, head)), None)
    if held is not None:
        return f"is a {held.name} file without points" if _is_empty(path, held.name) else None
    if named is not None and named.name == "text":
        return "holds no row of three numbers" if text and not holds_rows(path) else None
    kind = next((kind for start, kind in DOCUMENTS.items() if head.startswith(start)), None)
    return None if named is None or kind is None or not named.signatures else f"is {kind}, not {named.name}"


def _is_empty(path: Path, form: str) -> bool:
    try:
        if form == "LAS":
            return read_header(path).n_points == 0
        if form == "PLY":
            return read_ply_header(path).vertex.count == 0
        if form == "PCD":
            return read_pcd_header(path).n_points == 0
        small = path.stat().st_size <= SMALL
        return small and get_format(path).info(path, ReadOptions()).n_points == 0
    except DataError:  # damaged, or options describe it
        return False


def copies_beside(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the LAS and LAZ files that hold the points of another file of that name in their folder, and the reason.

    Of several, the one that is not cloud-optimised is kept, LAZ before LAS.
    """
    groups: dict[tuple[Path, str], list[Path]] = {}
    for path in paths:
        name = unpacked_name(path)
        if name.lower().endswith((".las", ".laz")):
            stem = name[:-4].removesuffix(".copc") if name.lower().endswith(".laz") else name[:-4]
            groups.setdefault((path.parent, stem), []).append(path)
    reasons = {}
    for group in (group for group in groups.values() if len(group) > 1):
        kept, *others = sorted(
            group, key=lambda path: (path.name.lower().endswith(SUFFIX), path.suffix.lower() != ".laz", path.name)
        )
        for path in others:
            if _same_points(kept, path):
                kind = "cloud-optimised copy" if path.name.lower().endswith(SUFFIX) else "copy"
                reasons[path] = f"is a {kind} of {kept.name}"
    return reasons


def _same_points(one: Path, other: Path) -> bool:
    try:
        first, second = read_header(one), read_header(other)
    except ReadError:  # reading it gives the error
        return False
    steps = np.abs([first.scale, second.scale]).max(axis=0)
    same = (np.abs(first.bounds - second.bounds) <= 2 * steps).all()
    return first.n_points == second.n_points and bool(same)
