"""Thread pool with look-ahead; results do not depend on the number of threads."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_SWITCH = 0.0002  # seconds a thread may hold the interpreter lock while others wait


@contextmanager
def thread_pool(count: int) -> Iterator[ThreadPoolExecutor | None]:
    """Yield a pool of threads, or None for a count of 0; pending tasks are cancelled on exit."""
    if count == 0:
        yield None
        return
    pool = ThreadPoolExecutor(count)
    # Compiled code releases the interpreter lock and takes it back often: waits of 5 ms would add up.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, _SWITCH))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        sys.setswitchinterval(interval)


def map_ahead(
    pool: ThreadPoolExecutor | None, function: Callable[[T], R], items: Iterable[T], ahead: int
) -> Iterator[R]:
    """Apply a function to items and yield the results in order.

    At most `ahead` results beyond the next one are computed early, which bounds the memory. Without a pool the caller's
    thread computes item by item.
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
