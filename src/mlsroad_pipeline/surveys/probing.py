"""Files of a folder that hold no points in spite of their names: empty files, lists of words, other documents."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.formats.content import first_bytes, unpacked_name
from mlsroad_pipeline.formats.las.copc import SUFFIX
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.options import ReadOptions
from mlsroad_pipeline.formats.pcd.header import read_pcd_header
from mlsroad_pipeline.formats.ply.header import read_ply_header
from mlsroad_pipeline.formats.registry import FORMATS, format_of_name, get_format
from mlsroad_pipeline.formats.text.layout import holds_rows

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
