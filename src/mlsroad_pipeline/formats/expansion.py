"""Limit of what a file may become in memory: points that no scanner records, packed into a few bytes."""

from __future__ import annotations

from pathlib import Path

from mlsroad_pipeline.algorithms.core.exceptions import ReadError

LARGEST_RATIO = 200
"""Largest ratio of unpacked to packed bytes; recordings reach about 30."""

ALLOWED = 1 << 28
"""Unpacked bytes that any file may have."""


def check_expansion(path: Path, unpacked: int, packed: int) -> None:
    """Raise `ReadError` for a file that unpacks to far more than a recording does.

    That is more than `ALLOWED` bytes and more than `LARGEST_RATIO` times its packed size.
    """
    if unpacked > max(ALLOWED, LARGEST_RATIO * packed):
        raise ReadError(
            f"{path} is damaged or made to fill the memory: its {packed} bytes would become {unpacked} or more"
        )
