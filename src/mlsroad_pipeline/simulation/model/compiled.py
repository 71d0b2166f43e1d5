"""How small functions are compiled that read arrays and make none."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def leaf(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function that is called for every ray without counting references to its arrays.

    Counting them needs atomic operations at every call, which take several times as long as such a function.

    Parameters
    ----------
    function : callable
        It may read and write arrays and take views of them, but neither make nor return one; what it calls must be such
        a function too.

    Returns
    -------
    callable
        The compiled function.
    """
    return cast(Callable[P, R], njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(function))
