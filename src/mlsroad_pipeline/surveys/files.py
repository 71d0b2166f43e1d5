"""Files of a survey and of its splits."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.scenes.splits import SplitPart, check_splits_along, check_splits_sectors
from mlsroad_pipeline.formats.files import first_bytes
from mlsroad_pipeline.formats.registry import format_of_name
from mlsroad_pipeline.surveys.discovery import (
    broken_links,
    copies_beside,
    find_point_files,
    find_split_files,
    no_points_reason,
)

RESULTS = ".mlsroad"
"""Folder that marks an output folder of `label`: `execution.run_identity.STATE`."""

BROKEN = "is a link to a file that does not exist: skipped"
IN_RESULTS = "is in a folder of labelled results: skipped"
"""Reason for leaving out a result of an earlier run."""

TABLES = ("text", "Parquet", "NPZ")
"""Formats whose files may hold something other than points."""

TABLE = "is a table beside point clouds of another format: skipped"
"""Reason for which a table is left out."""

TRUTH = b"instance,label,"
"""Start of the table of true objects beside a simulated street, which `score` reads."""


@dataclass(frozen=True)
class SurveyFile:
    """One file of a survey."""

    path: str  # Path of the file
    name: str  # Path below the root of the survey, with forward slashes
    folder: str  # Folder below the root; the files of a folder are one pass and are cut together
    trajectory: str | None  # Path of the trajectory beside the file


def check_name(path: str | Path) -> None:
    """Raise ReadError for a file whose name is not UTF-8, as results write it."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ReadError(
            f"'{printable(path)}' is a file of the survey with a name that is not UTF-8: rename it"
        ) from None


@dataclass(frozen=True)
class SurveyListing:
    """Files of a survey, and those left out."""

    files: list[SurveyFile]  # Files of points
    skipped: Mapping[str, str]  # Name of each file left out to the reason


@dataclass(frozen=True)
class Survey:
    """Places of a survey's files."""

    roots: tuple[str, ...]  # Files, folders and globs. Named files may lie in different folders.

    @classmethod
    def at(cls, places: str | Path | Sequence[str | Path]) -> Survey:
        """Return the survey at a file, a folder or a glob, or at several of them; ``~`` is the home folder."""
        listed = list(places) if isinstance(places, Sequence) and not isinstance(places, str) else [places]
        if not listed:
            raise ParameterError("a survey needs at least one file, folder or glob, got none")
        return cls(tuple(dict.fromkeys(os.path.expanduser(str(place)) for place in listed)))

    @property
    def root(self) -> str:
        """The places as text."""
        return ", ".join(self.roots)

    @property
    def folder(self) -> Path:
        """Folder that the names of the files are relative to."""
        folders = [_folder_of(Path(root)) for root in self.roots]
        return folders[0] if len(folders) == 1 else Path(os.path.commonpath([folder.absolute() for folder in folders]))

    def listing(self, *, trajectory: str | None = None, text: bool = True) -> SurveyListing:
        """Return all files of points, and those left out of folders and globs.

        Tables (`TABLES`) beside point clouds of another format are left out, since surveys are delivered with
        trajectories, lists of objects and calibrations; a glob of such files includes them.
        """
        paths: list[Path] = []
        reasons: dict[Path, str] = {}
        named = {Path(root).absolute() for root in self.roots}
        for root in self.roots:
            below = find_point_files(root)
            reasons |= dict.fromkeys(broken_links(root), BROKEN)
            results = _in_results(below, _folder_of(Path(root)))
            reasons |= dict.fromkeys(results, IN_RESULTS)
            below = [path for path in below if path not in results]
            if Path(root).is_dir():
                tables = _tables_beside(below)
                truth = {p for p in tables if p.name == "objects.csv" and first_bytes(p, len(TRUTH)) == TRUTH}
                reasons |= {path: TABLE for path in tables - truth if path.name != trajectory}
                below = [path for path in below if path not in tables]
            copies = {path: f"{reason}: skipped" for path, reason in copies_beside(below).items()}
            reasons |= {path: reason for path, reason in copies.items() if path.absolute() not in named}
            for path in (path for path in below if path.absolute() not in named and path.name != trajectory):
                reason = no_points_reason(path, text=text)
                reasons |= {path: f"{reason}: skipped"} if reason else {}
            paths += [path for path in below if path not in reasons]
        if len(self.roots) > 1:
            paths = sorted({path.absolute() for path in paths})
            reasons = {path.absolute(): reason for path, reason in reasons.items() if path.absolute() not in paths}
        skipped = {
            printable(path.relative_to(self.folder).as_posix()): reason for path, reason in sorted(reasons.items())
        }
        if not paths:
            listed = "; ".join(f"{name} {reason.removesuffix(': skipped')}" for name, reason in skipped.items())
            raise ReadError(f"{self.root} holds no point cloud: {listed}")
        for path in paths:
            check_name(path)
        return SurveyListing(self._described(paths, trajectory), skipped)

    def split_files(
        self, splits: Mapping[str, tuple[Sequence[str], SplitPart]], *, trajectory: str | None = None
    ) -> dict[str, list[SurveyFile]]:
        """Return the files of each split."""
        if not splits:
            raise ParameterError("survey.splits must name at least one split, got none")
        split_files = {
            name: self._described(find_split_files(self.roots[0], name, globs), trajectory)
            for name, (globs, _) in splits.items()
        }
        for (one, files), (other, others) in combinations(split_files.items(), 2):
            shared = sorted({file.name for file in files} & {file.name for file in others})
            if shared:
                _check_disjoint(shared[0], {one: splits[one][1], other: splits[other][1]})
        return split_files

    def _described(self, paths: Sequence[Path], trajectory: str | None) -> list[SurveyFile]:
        files = []
        for path in paths:
            if trajectory is not None and path.name == trajectory:
                continue
            name = path.relative_to(self.folder)
            if ".." in name.parts:  # its results would lie outside the output
                raise ParameterError(f"{self.root} leaves its folder by '..' after a wildcard: {path}; name the folder")
            beside = None if trajectory is None else path.parent / trajectory
            existing = str(beside) if beside is not None and beside.is_file() else None
            files.append(SurveyFile(str(path), name.as_posix(), name.parent.as_posix(), existing))
        if not files:
            raise ReadError(f"{self.root} holds no point cloud, only the trajectory {trajectory}")
        return files


def _folder_of(root: Path) -> Path:
    """Return a folder itself, the folder of a file, or that before the first wildcard of a glob."""
    if root.is_dir():
        return root
    if root.is_file():  # its folders may have brackets in their names
        return root.parent
    magic = next((i for i, part in enumerate(root.parts) if any(c in part for c in "*?[")), len(root.parts) - 1)
    return Path(*root.parts[:magic])


def _in_results(paths: Sequence[Path], root: Path) -> set[Path]:
    """Return the files in folders below the root that `label` has written results to."""
    known: dict[Path, bool] = {root: False}

    def holds(folder: Path) -> bool:
        if folder not in known:
            inside = folder.parent != folder and holds(folder.parent)
            known[folder] = inside or (folder.is_relative_to(root) and (folder / RESULTS).is_dir())
        return known[folder]

    return {path for path in paths if holds(path.parent)}


def _tables_beside(paths: Sequence[Path]) -> set[Path]:
    """Return the tables in folders that hold point clouds of another format."""
    tables = {path for path in paths if getattr(format_of_name(path), "name", None) in TABLES}
    clouds = {path.parent for path in paths if path not in tables}
    return {path for path in tables if path.parent in clouds}


def _check_disjoint(file: str, parts: Mapping[str, SplitPart]) -> None:
    """Check that two splits share no point of a file."""
    names = " and ".join(repr(name) for name in parts)
    if all(part.sectors is not None for part in parts.values()):
        check_splits_sectors({name: part.sectors or () for name, part in parts.items()})
    elif all(part.along is not None for part in parts.values()):
        longest = max(part.along[1] for part in parts.values() if part.along)
        units = {part.along[1] <= 1 for part in parts.values() if part.along}
        if len(units) > 1:
            raise ParameterError(f"splits {names} share {file}: give both `along` as fractions or both in metres")
        check_splits_along({name: part.along or () for name, part in parts.items()}, length=min(longest, 1.0))
    else:
        raise ParameterError(f"splits {names} share {file}: each point belongs to one split only")


def files_to_label(survey: Survey, output: str, *, trajectory: str | None = None, text: bool = True) -> SurveyListing:
    """Return the files of a survey to label; earlier results in the output folder are left out without a reason."""
    if not output:
        raise ParameterError("label.output must name a folder, got ''")
    folder = Path(output).expanduser().resolve()
    _check_writable(folder)
    if folder == survey.folder.resolve():
        raise ParameterError(f"label.output is a folder of the survey itself: {output}; choose another")
    listing = survey.listing(trajectory=trajectory, text=text)
    own = next((file.name for file in listing.files if Path(file.path).resolve().is_relative_to(folder)), None)
    if own is not None:
        raise ParameterError(f"label.output is a folder of the survey itself: {output} holds {own}; choose another")
    outside = {
        name: reason
        for name, reason in listing.skipped.items()
        if not (survey.folder / name).resolve().is_relative_to(folder)
    }
    return SurveyListing(listing.files, outside)


def _check_writable(folder: Path) -> None:
    """Check before the labelling that the folder can be created and written; create nothing."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise ParameterError(f"label.output: {folder} cannot be written: {existing}: {error.strerror}") from error
