"""Class taxonomy of streets, and class schemes.

A *class scheme* groups taxonomy classes into the classes of one comparison. Schemes are configuration: a new class list
needs no code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, UnknownClassError

IGNORE = -1
"""Label of points that are excluded from training and scoring."""

TAXONOMY: dict[str, int] = {
    "unlabelled": 0,
    # ground
    "road": 1,
    "lane_marking": 2,
    "parking": 3,
    "sidewalk": 4,
    "curb": 5,
    "manhole": 6,
    "trail": 7,
    "grass": 8,
    "soil": 9,
    "other_ground": 10,
    # structures
    "building": 20,
    "wall": 21,
    "fence": 22,
    "stairs": 23,
    "bridge": 24,
    "guardrail": 25,
    "other_structure": 26,
    # vegetation
    "trunk": 30,
    "tree": 31,
    "palm": 32,
    "cycas": 33,
    "brushwood": 34,
    "hedge": 35,
    "other_vegetation": 36,
    # poles, signs and wires
    "utility_pole": 40,
    "light_pole": 41,
    "traffic_sign": 42,
    "traffic_light": 43,
    "post": 44,
    "gantry": 45,
    "transformer": 46,
    "station_sign": 47,
    "wire": 48,
    "support_wire": 49,
    # vehicles
    "car": 50,
    "van": 51,
    "truck": 52,
    "bus": 53,
    "train": 54,
    "motorcycle": 55,
    "bicycle": 56,
    "other_vehicle": 57,
    # people and animals
    "person": 60,
    "rider": 61,
    "animal": 62,
    # street furniture
    "bus_shelter": 70,
    "bin": 71,
    "bench": 72,
    "bollard": 73,
    "hydrant": 74,
    "mail_box": 75,
    "parking_meter": 76,
    "other_object": 77,
    # artefacts
    "outlier": 90,
}
"""Taxonomy class to uint8 code. Scenes store these codes; they are never renumbered."""

TAXONOMY_NAMES: dict[int, str] = {code: name for name, code in TAXONOMY.items()}


def unknown_codes(codes: NDArray, known: NDArray, what: str, source: str) -> UnknownClassError:
    """Return the error that names codes that a coding or scheme lacks.

    Parameters
    ----------
    codes : ndarray of int, shape (n,)
        The codes.
    known : ndarray of int
        Known codes.
    what : str
        The coding or scheme.
    source : str
        Name of the file.

    Returns
    -------
    UnknownClassError
        The error, with the number of points of each unknown code.
    """
    values, counts = np.unique(codes[~np.isin(codes, known)], return_counts=True)
    listing = ", ".join(f"{value} ({count} points)" for value, count in zip(values, counts, strict=True))
    return UnknownClassError(f"{source}: codes missing from {what}: {listing}")


def _is_names(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(name, str) for name in value)


def _checked_specs(name: str, config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the classes of a configured scheme, each with its members and its code."""
    specs = config.get("classes") if isinstance(config, Mapping) else None
    if not isinstance(specs, Mapping) or not specs or not _is_names([*specs]):
        raise ParameterError(
            f"class scheme {name!r}: classes must have a list of members and asprs each, got {specs!r}"
        )
    for class_name, spec in specs.items():
        code = spec.get("asprs") if isinstance(spec, Mapping) else None
        if isinstance(code, bool) or not isinstance(code, int) or not _is_names(spec.get("members")):
            raise ParameterError(
                f"class scheme {name!r}: class {class_name!r} must have members, a list of taxonomy classes, and "
                f"asprs, a LAS code; got {spec!r}"
            )
    if not _is_names(config.get("ignore") or ()):
        raise ParameterError(f"class scheme {name!r}: ignore must list taxonomy classes, got {config['ignore']!r}")
    return specs


@dataclass(frozen=True)
class ClassScheme:
    """Classes of a comparison: groups of taxonomy classes, numbered from 0 without gaps.

    Parameters
    ----------
    name : str
        Name of the scheme, such as ``"tomic2019"``.
    classes : tuple of str
        Class names in the order of their labels.
    members : tuple of tuple of str
        Taxonomy classes of each class.
    ignored : tuple of str
        Taxonomy classes that are excluded from training and scoring.
    asprs : tuple of int
        LAS classification code of each class.
    """

    name: str
    classes: tuple[str, ...]
    members: tuple[tuple[str, ...], ...]
    ignored: tuple[str, ...]
    asprs: tuple[int, ...]

    @classmethod
    def from_config(cls, name: str, config: Mapping[str, Any]) -> ClassScheme:
        """Build a scheme from configuration.

        Parameters
        ----------
        name : str
            Name of the scheme.
        config : mapping
            ``classes``: class name to ``{members: [taxonomy classes], asprs: LAS code}``, in label order;
            ``ignore``: list of taxonomy classes.

        Returns
        -------
        ClassScheme
            The scheme.

        Raises
        ------
        ParameterError
            If a class lacks its members or its code, a member is not in the taxonomy or is listed twice, or a LAS code
            is outside 0 to 255.
        """
        specs = _checked_specs(name, config)
        members = tuple(tuple(spec["members"]) for spec in specs.values())
        ignored = tuple(config.get("ignore") or ())
        asprs = tuple(int(spec["asprs"]) for spec in specs.values())
        seen: set[str] = set()
        for taxonomy_class in [m for group in (*members, ignored) for m in group]:
            if taxonomy_class not in TAXONOMY:
                raise ParameterError(f"class scheme {name!r}: {taxonomy_class!r} is not in the taxonomy")
            if taxonomy_class in seen:
                raise ParameterError(f"class scheme {name!r}: {taxonomy_class!r} is listed twice")
            seen.add(taxonomy_class)
        if any(not 0 <= code <= 255 for code in asprs):
            raise ParameterError(f"class scheme {name!r}: LAS codes must be in 0..255, got {asprs}")
        return cls(name, tuple(specs), members, ignored, asprs)

    def __len__(self) -> int:
        """Return the number of classes."""
        return len(self.classes)

    def encode(self, taxonomy_codes: ArrayLike, *, source: str = "labels") -> NDArray[np.int16]:
        """Map taxonomy codes to labels of this scheme.

        Parameters
        ----------
        taxonomy_codes : array-like of int, shape (n,)
            Codes of `TAXONOMY`.
        source : str, default "labels"
            Name of the file in the error message.

        Returns
        -------
        ndarray of int16, shape (n,)
            Labels 0 to ``len(self) - 1``, and `IGNORE`.

        Raises
        ------
        UnknownClassError
            If a code belongs to no class and is not ignored; the message gives the code, its count and the file.
        """
        codes = np.asarray(taxonomy_codes).astype(np.int64)
        table = np.full(256, -2, dtype=np.int16)
        table[[TAXONOMY[name] for name in self.ignored]] = IGNORE
        for label, group in enumerate(self.members):
            table[[TAXONOMY[name] for name in group]] = label
        known = np.flatnonzero(table != -2)
        if not np.isin(codes, known).all():
            raise unknown_codes(codes, known, f"class scheme {self.name!r}", source)
        return table[codes]

    def labels_of(self, names: Sequence[str]) -> list[int]:
        """Return the labels of classes by name.

        Parameters
        ----------
        names : sequence of str
            Class names of this scheme.

        Returns
        -------
        list of int
            Their labels.

        Raises
        ------
        ParameterError
            If a name is not a class of the scheme.
        """
        for name in names:
            if name not in self.classes:
                raise ParameterError(f"class scheme {self.name!r} has no class {name!r} (classes: {self.classes})")
        return [self.classes.index(name) for name in names]

    def coarsen(self, other: ClassScheme) -> NDArray[np.int16]:
        """Return the label of each class in a coarser scheme.

        Parameters
        ----------
        other : ClassScheme
            A scheme whose classes are unions of classes of this one.

        Returns
        -------
        ndarray of int16, shape (len(self),)
            Label of each class in the other scheme; `IGNORE` if that scheme ignores all members of the class.

        Raises
        ------
        ParameterError
            If the members of a class do not all fall into one class of the other scheme.
        """
        table = np.empty(len(self), dtype=np.int16)
        for label, (name, group) in enumerate(zip(self.classes, self.members, strict=True)):
            targets = set(other.encode([TAXONOMY[member] for member in group], source=f"class {name!r}").tolist())
            if len(targets) != 1:
                raise ParameterError(
                    f"class {name!r} of scheme {self.name!r} falls into {len(targets)} classes of scheme {other.name!r}"
                    "; set a scheme that keeps it whole"
                )
            table[label] = targets.pop()
        return table

    def codes(self, scheme: ClassScheme | None = None) -> NDArray[np.uint8]:
        """Return the LAS classification code of each class.

        Parameters
        ----------
        scheme : ClassScheme, optional
            Coarser scheme whose labels are written as private codes from 64. None writes the ASPRS codes of the
            configuration.

        Returns
        -------
        ndarray of uint8, shape (len(self),)
            Codes; 1 (unclassified) for classes that the coarser scheme ignores.

        Raises
        ------
        ParameterError
            If the classes do not nest in the coarser scheme.
        """
        if scheme is None:
            return np.array(self.asprs, dtype=np.uint8)
        coarse = self.coarsen(scheme)
        return np.where(coarse == IGNORE, 1, coarse + 64).astype(np.uint8)


def find_scheme(schemes: Mapping[str, Any], name: str) -> ClassScheme:
    """Return a class scheme of the configuration.

    Parameters
    ----------
    schemes : mapping of str to mapping
        The configured schemes.
    name : str
        Name of the scheme.

    Returns
    -------
    ClassScheme
        The scheme.

    Raises
    ------
    ParameterError
        If there is no such scheme, or it is malformed.
    """
    if name not in schemes:
        raise ParameterError(f"class scheme {name!r} is not configured (schemes: {', '.join(schemes)})")
    return ClassScheme.from_config(name, schemes[name])
