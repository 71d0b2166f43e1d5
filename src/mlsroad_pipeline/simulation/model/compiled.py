"""Compilation of leaf functions: small functions that read arrays and create none."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def leaf(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function that is called for every ray, without reference counting of its arrays.

    Reference counts need atomic operations at every call, which take several times as long as such a function.
    """
    return cast(Callable[P, R], njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(function))
