"""mlsroad: road scenes in mobile laser scanning point clouds."""

import os
import stat
import tempfile

__version__ = "0.1.0"

# Open3D brings a TBB that Numba refuses with a warning wherever both are loaded. The kernels run in thread pools of
# their own and need none of Numba's threading layers.
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")


def _temporary_kernels() -> str:
    """Return a folder of this user alone for compiled kernels: Numba runs what lies in it."""
    folder = os.path.join(tempfile.gettempdir(), f"mlsroad-kernels-{os.geteuid()}")
    try:
        os.mkdir(folder, 0o700)
    except OSError:  # it exists; that of another user is not taken
        state = os.lstat(folder) if os.path.lexists(folder) else None
        mode = 0 if state is None else state.st_mode
        if state is None or not stat.S_ISDIR(mode) or state.st_uid != os.geteuid() or mode & 0o077:
            return tempfile.mkdtemp(prefix="mlsroad-kernels-")
    return folder


def _is_writable(folder: str) -> bool:
    """Return whether a folder, or the nearest one above it that exists, can be written; no home is `~`."""
    while folder.startswith("/") and not os.path.lexists(folder):
        folder = os.path.dirname(folder)
    return folder.startswith("/") and os.access(folder, os.W_OK)


def _place_kernels() -> bool:
    """Set a temporary folder for compiled kernels where Numba finds no other, and return whether it was set."""
    caches = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    package = os.path.join(os.path.dirname(os.path.abspath(__file__)), "algorithms")
    if os.environ.get("NUMBA_CACHE_DIR") or _is_writable(package) or _is_writable(os.path.join(caches, "numba")):
        return False
    os.environ["NUMBA_CACHE_DIR"] = _temporary_kernels()
    return True


kernels_in_temporary_folder = _place_kernels()
