"""mlsroad: road scenes in mobile laser scanning point clouds."""

import os

__version__ = "0.1.0"

# Open3D brings a TBB that Numba refuses with a warning wherever both are loaded. The kernels run in thread pools of
# their own and need none of Numba's threading layers.
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")
