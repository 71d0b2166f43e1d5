"""Search for point cloud files below a folder or by glob."""

from __future__ import annotations

import fnmatch
import logging
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from glob import escape, glob, has_magic
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.formats.registry import format_of_name, known_extensions

logger = logging.getLogger(__name__)


def find_point_files(root: str | Path, patterns: Sequence[str] | None = None) -> list[Path]:
    """Return the point cloud files of a file, a folder or a glob, sorted; hidden files are left out."""
    path = Path(root)
    if path.is_file():
        return [path]
    if path.is_dir():
        matches = [match for pattern in (patterns or ["**/*"]) for match in _matching(path, pattern)]
    elif has_magic(str(root)):
        entries = _entries(path)
        matches = [
            match
            for entry in entries
            for match in (find_point_files(entry) if entry.is_dir() and _has_point_files(entry) else [entry])
        ]
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


def _has_point_files(folder: Path) -> bool:
    return any(p.is_file() and format_of_name(p) is not None for p in folder.rglob("*"))


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
