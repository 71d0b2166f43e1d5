"""Choice of the reader of a file: by content, else by file name."""

from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.formats.base import PointFormat
from mlsroad_pipeline.formats.e57.format import E57Format
from mlsroad_pipeline.formats.files import GZIP, check_file, first_bytes, is_packed
from mlsroad_pipeline.formats.files import SUFFIX as GZIP_SUFFIX
from mlsroad_pipeline.formats.kitti import KittiFormat
from mlsroad_pipeline.formats.las.format import LasFormat
from mlsroad_pipeline.formats.npz import NpzFormat
from mlsroad_pipeline.formats.parquet import ParquetFormat
from mlsroad_pipeline.formats.pcd.format import PcdFormat
from mlsroad_pipeline.formats.ply.format import PlyFormat
from mlsroad_pipeline.formats.sydney import SydneyFormat
from mlsroad_pipeline.formats.text.format import TextFormat
from mlsroad_pipeline.formats.text.sniffing import looks_like_table

FORMATS: tuple[PointFormat, ...] = (
    *(LasFormat(), PlyFormat(), PcdFormat(), TextFormat()),
    *(KittiFormat(), SydneyFormat(), E57Format()),
    *(ParquetFormat(), NpzFormat()),
)
"""All formats; a new one is one module and one entry here."""

FOREIGN = {
    **{b"PK\x03\x04": "ZIP", GZIP: "gzip", b"\x89PNG": "PNG", b"\xff\xfe": "UTF-16 text", b"\xfe\xff": "UTF-16 text"},
    **{b"CCB": "CloudCompare's own format", b"\x89HDF": "HDF5", b"SQLite format 3": "SQLite", b"%PDF": "PDF"},
    **{b"\xd4\xc3\xb2\xa1": "packets of a network (PCAP)", b"\x0a\x0d\x0d\x0a": "packets of a network (PCAP)"},
}
"""Signatures of unsupported containers, named in messages."""


def known_extensions() -> tuple[str, ...]:
    """Return the file name endings of all formats: lower case, with the dot, sorted."""
    return tuple(sorted({extension for entry in FORMATS for extension in entry.extensions}))


def format_of_name(path: str | Path) -> PointFormat | None:
    """Return the format with the longest ending that a file name has, or None; the file need not exist."""
    name = Path(path).name.lower()
    matches = [(len(e), entry) for entry in FORMATS for e in entry.extensions if name.endswith(e)]
    return max(matches, key=lambda match: match[0])[1] if matches else None  # of several, the first of FORMATS


def get_format(path: str | Path) -> PointFormat:
    """Return the format of an existing file: of its first bytes, else of its name; `ReadError` if they disagree."""
    path = check_file(path)
    packed, named = is_packed(path), format_of_name(path)
    if packed and named is not None and not path.name.lower().endswith(GZIP_SUFFIX):
        raise ReadError(f"{path} is named as {named.name}, but holds gzip")
    head = first_bytes(path, 16)
    held = next((entry for entry in FORMATS if entry.recognises(path, head)), None)
    if not packed and named is not None and path.name.lower().endswith(GZIP_SUFFIX):
        raise ReadError(f"{path} is named as gzip, but holds {_content(head, held, packed=False)}")
    if held is None and _foreign(head) is None:
        if named is not None and not named.signatures:
            return named
        if named is None and looks_like_table(path):
            return next(entry for entry in FORMATS if isinstance(entry, TextFormat))
    elif held is not None:
        may_be_packed = any(extension.endswith(GZIP_SUFFIX) for extension in held.extensions)
        if path.name.lower().endswith(held.extensions) if named is not None else may_be_packed or not packed:
            return held
    content = _content(head, held, packed=packed)
    if named is None:
        known = ", ".join(known_extensions())
        raise ReadError(f"{path} is of no known format: it holds {content} (known extensions: {known})")
    raise ReadError(f"{path} is named as {named.name}, but holds {content}")


def _content(head: bytes, held: PointFormat | None, *, packed: bool) -> str:
    content = held.name if held is not None else _foreign(head) or f"something that begins with {head[:8]!r}"
    return f"gzip of {content}" if packed else content


def _foreign(head: bytes) -> str | None:
    return next((name for signature, name in FOREIGN.items() if head.startswith(signature)), None)
