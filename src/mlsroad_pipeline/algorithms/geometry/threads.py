"""Calls of compiled kernels, which release the GIL, on ranges of items in a thread pool."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least


def check_threads(n_threads: int) -> int:
    """Check a number of threads and return it."""
    if not isinstance(n_threads, int | np.integer):
        raise ParameterError(f"n_threads must be an integer, got {n_threads!r}")
    check_at_least(n_threads, 1, "n_threads")
    return int(n_threads)


def run_in_chunks(kernel: Callable[..., Any], n_items: int, *, n_threads: int) -> list[Any]:
    """Call ``kernel(start, stop)`` on contiguous chunks of items, in a thread pool."""
    check_threads(n_threads)
    if n_threads == 1 or n_items < 2:
        return [kernel(0, n_items)]
    # More chunks than threads balance the load between dense and sparse parts of the cloud.
    bounds = np.linspace(0, n_items, 1 + min(n_items, 8 * n_threads)).astype(np.int64).tolist()
    with ThreadPoolExecutor(n_threads) as pool:
        return list(pool.map(kernel, bounds[:-1], bounds[1:]))


def run_ranges(work: Callable[[int, int], Any], n_items: int, n_threads: int) -> list[Any]:
    """Call ``work(start, stop)`` on one contiguous range of items per thread."""
    if n_threads == 1:
        return [work(0, n_items)]
    limits = [n_items * k // n_threads for k in range(n_threads + 1)]
    with ThreadPoolExecutor(n_threads) as pool:
        return list(pool.map(work, limits[:-1], limits[1:]))
