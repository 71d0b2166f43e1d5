"""Rules that form the objects of the inventory from the points of a class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least

KINDS = ("pole", "sign", "vehicle", "tree")
"""Kinds of objects; base point, width and tilt are defined per kind."""

_DEFAULTS: dict[str, dict[str, Any]] = {
    # Signs and foliage interrupt the points of a pole: parts above each other are merged.
    "pole": {
        "tolerance": 0.3,
        "vertical_tolerance": 2.0,
        "min_points": 20,
        "min_height": 1.0,
        "max_height": 25.0,
        "max_width": 8.0,
        "max_clearance": 2.0,
        "resolution": 0.05,
    },
    "sign": {
        "tolerance": 0.25,
        "vertical_tolerance": 1.0,
        "min_points": 10,
        "min_height": 0.15,
        "max_height": 10.0,
        "max_width": 12.0,
    },
    # Parked cars stand half a metre apart or less: a larger tolerance would merge a row of them.
    "vehicle": {
        "tolerance": 0.3,
        "min_points": 50,
        "min_height": 0.6,
        "max_height": 5.0,
        "min_width": 1.2,  # the rear of a car alone is wider
        "max_width": 20.0,
        "max_clearance": 1.0,
        "resolution": 0.05,
    },
    "tree": {
        "tolerance": 0.6,
        "min_points": 100,
        "min_height": 1.0,
        "max_height": 45.0,
        "max_clearance": 6.0,
        "resolution": 0.1,
        "split_spacing": 3.0,
    },
}

KIND_OF_CLASS = {
    **dict.fromkeys(("utility_pole", "light_pole", "traffic_light", "post", "gantry", "transformer"), "pole"),
    **dict.fromkeys(("traffic_sign", "station_sign"), "sign"),
    **dict.fromkeys(("car", "van", "truck", "bus", "train", "other_vehicle"), "vehicle"),
    **dict.fromkeys(("trunk", "tree", "palm", "cycas"), "tree"),
}
"""Taxonomy class to kind of object."""


@dataclass(frozen=True)
class ObjectRule:
    """Rule for the objects of a class. `ObjectRule.of_kind` returns the defaults of a kind."""

    kind: str  # One of `KINDS`
    labels: tuple[int, ...]  # Labels of the class; their points are clustered together
    # Largest horizontal gap within an object, metres. Larger merges neighbours, smaller splits sparse objects.
    tolerance: float
    vertical_tolerance: float | None = None  # Largest vertical gap, metres, not below `tolerance`; None is `tolerance`
    min_points: int = 10  # Objects with fewer points are discarded
    # min_height, max_height: bounds of the height above the base, metres
    min_height: float = 0.0
    max_height: float = np.inf
    # min_width, max_width: bounds of the longest horizontal side, metres
    min_width: float = 0.0
    max_width: float = np.inf
    # Largest height of the bottom of an object above the ground, metres; not tested where the ground is unknown
    max_clearance: float = np.inf
    # Edge length of the voxels for measuring, metres; the measures are accurate to about half of it. At most
    # ``tolerance / sqrt(3)``.
    resolution: float = 0.05
    # Minimum distance between the tops of touching objects that are split, metres; None never splits. Larger merges
    # neighbouring trees, smaller splits broad crowns.
    split_spacing: float | None = None
    split_depth: float = 1.0  # Minimum depth of the valley below the lower of two tops, metres

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ParameterError(f"kind must be one of {KINDS}, got {self.kind!r}")
        for name, value in vars(self).items():
            if name != "kind" and isinstance(value, str):
                raise ParameterError(f"{name} must be a number, got {value!r}")
        if not self.labels:
            raise ParameterError(f"a rule for {self.kind} objects needs at least one label")
        check_at_least(self.min_points, 1, "min_points")
        for name in ("tolerance", "resolution", "split_depth", "max_height", "max_width"):
            if not getattr(self, name) > 0:
                raise ParameterError(f"{name} must be a number > 0, got {getattr(self, name)!r}")
        if self.split_spacing is not None and not self.split_spacing > 0:
            raise ParameterError(f"split_spacing must be a number > 0 or None, got {self.split_spacing!r}")
        if not 0 <= self.min_height <= self.max_height:
            raise ParameterError(f"heights must be 0 <= {self.min_height!r} (min) <= {self.max_height!r} (max)")
        if not 0 <= self.min_width <= self.max_width:
            raise ParameterError(f"widths must be 0 <= {self.min_width!r} (min) <= {self.max_width!r} (max)")
        if self.vertical_tolerance is not None and self.vertical_tolerance < self.tolerance:
            raise ParameterError(
                f"vertical_tolerance ({self.vertical_tolerance!r}) must not be below tolerance ({self.tolerance!r})"
            )
        # Points of one voxel must belong to one object: fragments are merged by shared voxels.
        if self.resolution > self.tolerance / np.sqrt(3):
            raise ParameterError(f"resolution must be at most tolerance / sqrt(3), got {self.resolution!r}")

    @classmethod
    def of_kind(cls, kind: str, labels: tuple[int, ...] | int, **changes: Any) -> ObjectRule:
        """Return the default rule of a kind."""
        if kind not in KINDS:
            raise ParameterError(f"kind must be one of {KINDS}, got {kind!r}")
        unknown = sorted(set(changes) - set(cls.__dataclass_fields__))
        if unknown:
            raise ParameterError(f"an object rule has no field {unknown[0]!r}")
        group = (labels,) if isinstance(labels, int) else tuple(labels)
        return cls(kind=kind, labels=group, **{**_DEFAULTS[kind], **changes})


def rules_for_scheme(
    scheme: ClassScheme, *, changes: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, ObjectRule]:
    """Return the rules of the classes of a scheme that consist of poles, signs, vehicles or trees."""
    overrides = dict(changes or {})
    for name in overrides:
        if name not in KINDS and name not in scheme.classes:
            raise ParameterError(f"rules name {name!r}, neither a kind {KINDS} nor a class {scheme.classes}")
    rules: dict[str, ObjectRule] = {}
    for label, (name, members) in enumerate(zip(scheme.classes, scheme.members, strict=True)):
        own = dict(overrides.get(name, {}))
        kinds = {KIND_OF_CLASS.get(member) for member in members}
        kind = own.pop("kind", kinds.pop() if len(kinds) == 1 else None)
        if kind is not None:
            rules[name] = ObjectRule.of_kind(kind, label, **{**overrides.get(kind, {}), **own})
    return rules
