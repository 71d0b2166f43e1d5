"""Files of a folder that hold no points in spite of their names: empty files, lists of words, other documents."""

from __future__ import annotations

from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.content import first_bytes
from mlsroad_pipeline.formats.las.header import read_header
from mlsroad_pipeline.formats.registry import FORMATS, format_of_name
from mlsroad_pipeline.formats.text.layout import holds_rows

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
        return "is a LAS file without points" if held.name == "LAS" and _is_empty_las(path) else None
    if named is not None and named.name == "text":
        return "holds no row of three numbers" if text and not holds_rows(path) else None
    kind = next((kind for start, kind in DOCUMENTS.items() if head.startswith(start)), None)
    return None if named is None or kind is None or not named.signatures else f"is {kind}, not {named.name}"


def _is_empty_las(path: Path) -> bool:
    try:
        return read_header(path).n_points == 0
    except ReadError:  # damaged
        return False
