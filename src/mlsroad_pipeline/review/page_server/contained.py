"""Files that lie in an output folder, not outside of it by `..` or a link."""

from __future__ import annotations

from pathlib import Path


def resolved(folder: Path, name: str) -> Path | None:
    """Return a file below a folder, None if it is missing, hidden, or outside of the folder by `..` or a link."""
    parts = Path(name).parts
    if not parts or any(part.startswith(".") or "\0" in part for part in parts):
        return None
    try:
        path, root = (folder / name).resolve(strict=True), folder.resolve(strict=True)
    except OSError:
        return None
    return path if path.is_file() and path.is_relative_to(root) else None
