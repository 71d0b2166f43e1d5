"""Threads that work a little ahead of what is asked for; results do not depend on their number."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_SWITCH = 0.0002  # seconds that a thread may hold the interpreter while others wait


@contextmanager
def workers(count: int) -> Iterator[ThreadPoolExecutor | None]:
    """Yield a pool of threads, or None for no thread; what has not begun when it is left does not begin.

    Parameters
    ----------
    count : int
        Number of threads, at least 0.

    Yields
    ------
    ThreadPoolExecutor or None
        The pool.
    """
    if count == 0:
        yield None
        return
    pool = ThreadPoolExecutor(count)
    # Compiled code runs without the interpreter's lock and comes back for it often: waiting for 5 ms each time adds up.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, _SWITCH))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        sys.setswitchinterval(interval)


def ahead_of(
    pool: ThreadPoolExecutor | None, function: Callable[[T], R], items: Iterable[T], ahead: int
) -> Iterator[R]:
    """Apply a function to items in order, with a few more in work than have been asked for.

    Parameters
    ----------
    pool : ThreadPoolExecutor or None
        Who does it; None is the caller, item by item.
    function : callable
        From an item to a result.
    items : iterable
        The items.
    ahead : int
        How many results are worked on beyond the one asked for, which bounds what is held in memory.

    Yields
    ------
    object
        Results in the order of the items.
    """
    if pool is None:
        yield from map(function, items)
        return
    waiting: deque[Future[R]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
