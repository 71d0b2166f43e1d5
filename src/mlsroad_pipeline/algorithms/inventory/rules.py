"""What makes points of a class one object of the road inventory, and what makes it a false one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least

KINDS = ("pole", "sign", "vehicle", "tree")
"""What the inventory can measure; a kind decides how base point, width and tilt are taken."""

_DEFAULTS: dict[str, dict[str, Any]] = {
    # A pole's points break where a sign or foliage hides it: pieces one above the other are one pole.
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
    "sign": {"tolerance": 0.25, "min_points": 10, "min_height": 0.15, "max_height": 10.0, "max_width": 12.0},
    # Parked cars stand half a metre apart and less: a longer step would make a row of them one.
    "vehicle": {
        "tolerance": 0.3,
        "min_points": 50,
        "min_height": 0.6,
        "max_height": 5.0,
        "min_width": 1.2,  # the back of a car that hides the rest is wider
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
"""Taxonomy class to the kind of object that it is."""


@dataclass(frozen=True)
class ObjectRule:
    """How points of a class become objects. `ObjectRule.of_kind` gives a kind's defaults.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    labels : tuple of int
        The labels whose points make up the class; points of all of them are clustered together.
    tolerance : float
        The longest horizontal step within an object, metres. Larger joins neighbours, smaller breaks sparse objects.
    vertical_tolerance : float, optional
        The longest vertical step, metres, not below `tolerance`; None is `tolerance`.
    min_points : int, default 10
        Objects with fewer points are suppressed.
    min_height, max_height : float
        Bounds of the height above the base, metres.
    min_width, max_width : float
        Bounds of the longest horizontal side, metres.
    max_clearance : float
        The highest that an object's bottom may hang above the ground, metres; not asked where the ground is not known.
    resolution : float
        Edge of the voxels from whose mean points an object is measured, metres; the measures are good to about half of
        it. At most ``tolerance / sqrt(3)``.
    split_spacing : float, optional
        Objects that touch are split at the valleys between tops at least this far apart, metres; None never splits.
        Larger values leave neighbouring trees joined, smaller ones cut broad crowns.
    split_depth : float, default 1.0
        How far a valley must lie below the lower of two tops, metres.

    Raises
    ------
    ParameterError
        If the kind is not known, there is no label, a length is not above zero, `min_points` is below 1,
        `min_height` is above `max_height` or `min_width` above `max_width`, `vertical_tolerance` is below
        `tolerance`, or the voxels are too large.
    """

    kind: str
    labels: tuple[int, ...]
    tolerance: float
    vertical_tolerance: float | None = None
    min_points: int = 10
    min_height: float = 0.0
    max_height: float = np.inf
    min_width: float = 0.0
    max_width: float = np.inf
    max_clearance: float = np.inf
    resolution: float = 0.05
    split_spacing: float | None = None
    split_depth: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ParameterError(f"kind must be one of {KINDS}, got {self.kind!r}")
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
        # Two points of one voxel must never belong to two objects: pieces of an object are recognised by shared voxels.
        if self.resolution > self.tolerance / np.sqrt(3):
            raise ParameterError(f"resolution must be at most tolerance / sqrt(3), got {self.resolution!r}")

    @classmethod
    def of_kind(cls, kind: str, labels: tuple[int, ...] | int, **changes: Any) -> ObjectRule:
        """Return the rule of a kind with its default values.

        Parameters
        ----------
        kind : str
            One of `KINDS`.
        labels : int or tuple of int
            The labels whose points make up the class.
        **changes : Any
            Fields that differ from the defaults.

        Returns
        -------
        ObjectRule
            The rule.

        Raises
        ------
        ParameterError
            If the kind or a field is not known, or a value is outside its domain.
        """
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
    """Give every class of a scheme that consists of poles, signs, vehicles or trees the rule of its kind.

    Parameters
    ----------
    scheme : ClassScheme
        The classes. A class is mapped where all of its members are of one kind: a class that mixes trunks with
        brushwood is not a class of trees.
    changes : mapping of str to mapping, optional
        Fields of `ObjectRule` that differ from the defaults, by kind or by class name (the class name wins). A class
        whose members are mixed is mapped where its changes name a ``kind``.

    Returns
    -------
    dict of str to ObjectRule
        Rules by class name, in the scheme's order; may be empty.

    Raises
    ------
    ParameterError
        If `changes` names neither a kind nor a class, or holds a field or value that `ObjectRule` refuses.
    """
    given = dict(changes or {})
    for name in given:
        if name not in KINDS and name not in scheme.classes:
            raise ParameterError(f"rules name {name!r}, neither a kind {KINDS} nor a class {scheme.classes}")
    rules: dict[str, ObjectRule] = {}
    for label, (name, members) in enumerate(zip(scheme.classes, scheme.members, strict=True)):
        own = dict(given.get(name, {}))
        kinds = {KIND_OF_CLASS.get(member) for member in members}
        kind = own.pop("kind", kinds.pop() if len(kinds) == 1 else None)
        if kind is not None:
            rules[name] = ObjectRule.of_kind(kind, label, **{**given.get(kind, {}), **own})
    return rules
