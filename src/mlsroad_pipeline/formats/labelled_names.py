"""Column names of labelling results in every format."""

from __future__ import annotations

from collections.abc import Sequence

CLASS, CONFIDENCE = "classification", "confidence"


def kept_name(name: str, taken: Sequence[str]) -> str:
    """Return a new name for an input column whose name is reserved for the result.

    Parameters
    ----------
    name : str
        The column's name.
    taken : sequence of str
        All names of the input.

    Returns
    -------
    str
        The name with ``original_`` prefixed, repeatedly if needed to be unique.
    """
    free = f"original_{name}"
    while free in taken:
        free = f"original_{free}"
    return free
