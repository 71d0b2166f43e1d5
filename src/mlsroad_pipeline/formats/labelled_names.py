"""What the results of labelling are called, in every format."""

from __future__ import annotations

from collections.abc import Sequence

CLASS, CONFIDENCE = "classification", "confidence"


def kept_name(name: str, taken: Sequence[str]) -> str:
    """Return what an own column of the input is called when the result needs its name.

    Parameters
    ----------
    name : str
        The column's name.
    taken : sequence of str
        All names of the input.

    Returns
    -------
    str
        The name with ``original_`` before it, as often as it takes to be free.
    """
    free = f"original_{name}"
    while free in taken:
        free = f"original_{free}"
    return free
