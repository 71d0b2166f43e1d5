"""Heads of street lamps: what reaches out at the top of a slim pole."""

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.inventory.objects.axes import Axis

POLE_TYPES = ("lamp", "utility")
"""Types of poles that are listed; those of others are empty."""

_FROM, _LEAST_HEIGHT = 0.5, 2.4  # height from which points count, and of a lamp, metres
_TOP_SHARE, _TOP = 0.12, 0.7  # height of the top, as a share of the pole's and at least, metres
_SHAFT = (0.3, 0.75)  # shares of the height of the shaft
_HEAD, _WIDER = 0.1, 2.0  # least distance of a head from the axis, metres and as a multiple of the shaft's
_REACH = 3.5  # masts with longer arms carry signals or signs, metres
_BESIDE, _MOST_BESIDE = 0.35, 0.3  # metres from the axis below the top, and largest share of points beyond


def has_lamp_head(xyz: NDArray[np.float64], base: float, axis: Axis | None) -> bool:
    """Return whether a pole has a head or an arm at its top alone."""
    height = xyz[:, 2] - base
    xyz, height = xyz[height > _FROM], height[height > _FROM]
    if not len(xyz) or float(height.max()) < _LEAST_HEIGHT:
        return False
    tall = float(height.max())
    away = np.hypot(*(xyz[:, :2] - np.median(xyz[:, :2], axis=0)).T) if axis is None else axis.distance(xyz)
    top = height > tall - max(_TOP_SHARE * tall, _TOP)
    shaft = away[(height > _SHAFT[0] * tall) & (height < _SHAFT[1] * tall) & ~top]
    thick = float(np.quantile(shaft, 0.75)) if len(shaft) else 0.0
    if float(np.quantile(away[top], 0.9)) <= max(_HEAD, _WIDER * thick) or float(away[top].max()) >= _REACH:
        return False
    return top.all() or float(np.mean(away[~top] > _BESIDE)) < _MOST_BESIDE
