"""Finding the files of a survey, and of its splits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from glob import glob, has_magic
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.formats.registry import format_of_name, known_extensions


def find_surveys(root: str | Path, patterns: str | Sequence[str] | None = None) -> list[Path]:
    """List the point cloud files of a survey.

    Raises
    ------
    ReadError
        If nothing is found; the message names what was looked for.
    """
    path = Path(root)
    wanted = [patterns] if isinstance(patterns, str) else patterns
    if path.is_file():
        return [path]
    if path.is_dir():
        found = [p for pattern in (wanted or ["**/*"]) for p in _matching(path, pattern)]
    elif has_magic(str(root)):
        found = [Path(p) for p in glob(str(root), recursive=True)]
        found = [p for entry in found for p in (find_surveys(entry) if entry.is_dir() and _holds(entry) else [entry])]
    else:
        raise ReadError(f"{root} does not exist")
    files = sorted({p for p in found if p.is_file() and format_of_name(p) is not None and not _hidden(p, path)})
    if not files:
        what = f"{root} with {', '.join(wanted)}" if wanted else str(root)
        raise ReadError(f"no point cloud found in {what} (extensions: {', '.join(known_extensions())})")
    return files


def _matching(folder: Path, pattern: str) -> list[Path]:
    if Path(pattern).is_absolute() or ".." in Path(pattern).parts:
        raise ParameterError(f"pattern {pattern!r} must stay below {folder}")
    matches = [folder / match for match in glob(pattern, root_dir=folder, recursive=True)]
    return [p for match in matches for p in (match.rglob("*") if match.is_dir() and pattern != "**/*" else [match])]


def _holds(folder: Path) -> bool:
    return any(p.is_file() and format_of_name(p) is not None for p in folder.rglob("*"))


def _hidden(path: Path, root: Path) -> bool:
    parts = path.relative_to(root).parts if path.is_relative_to(root) else (path.name,)
    return any(part.startswith(".") for part in parts)


def resolve_splits(root: str | Path, splits: Mapping[str, str | Sequence[str]]) -> dict[str, list[Path]]:
    """List the files of each split.

    Raises
    ------
    ParameterError
        If there is no split, a split without patterns, or a file in two splits.
    ReadError
        If the folder does not exist or a split matches nothing.
    """
    folder = Path(root)
    if not folder.is_dir():
        raise ReadError(f"{folder} is not a folder")
    if not splits:
        raise ParameterError("splits must name at least one split, got none")
    resolved: dict[str, list[Path]] = {}
    owner: dict[Path, str] = {}
    for name, patterns in splits.items():
        globs = [patterns] if isinstance(patterns, str) else list(patterns)
        if not globs:
            raise ParameterError(f"split {name!r} has no patterns")
        try:
            files = find_surveys(folder, globs)
        except ReadError as error:
            raise ReadError(f"split {name!r} matches nothing: {error}") from error
        for path in files:
            if path in owner:
                raise ParameterError(f"{path} is in two splits: {owner[path]!r} and {name!r}")
            owner[path] = name
        resolved[name] = files
    return resolved
