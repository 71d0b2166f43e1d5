"""Imports without the optional packages that a library would load for functions which are not used here."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without(*names: str) -> Iterator[None]:
    """Make packages that are not loaded yet seem absent, for libraries that try to import them.

    Kedro's settings bring Flask (0.12 s of processor time), laspy requests for files on servers, Numba coverage.
    """
    hidden = [name for name in names if name not in sys.modules]
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None stops an import
    try:
        yield
    finally:
        for name in hidden:
            del sys.modules[name]
