"""Parameters of a study with named scales, and changes of parameter dataclasses."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar, Generic, TypeVar

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.models.methods import METHODS

Scale = TypeVar("Scale")


def chosen_scale(kind: type[Scale], study: str, name: str, scales: Mapping[str, Any]) -> Scale:
    """Return a scale of a study by its name."""
    return from_fields(kind, f"{study}.scales.{name}", scale_values(study, name, scales))


def scale_values(study: str, name: str, scales: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the configured values of a scale."""
    if name not in scales:
        raise ParameterError(f"{study}.scale {name!r} is unknown (scales: {', '.join(scales)})")
    values: Mapping[str, Any] = scales[name]
    return values


def from_fields(kind: type[Scale], where: str, values: Mapping[str, Any]) -> Scale:
    """Create a dataclass from a mapping that has exactly its fields."""
    known = {entry.name for entry in fields(kind)}  # type: ignore[arg-type]  # callers pass dataclasses
    if set(values) != known:
        raise ParameterError(f"{where} must have {sorted(known)}, got {sorted(values)}")
    return kind(**values)


@dataclass(frozen=True)
class ScaledStudy(Generic[Scale]):
    """Parameters of a study that is run at one of several scales.

    A study names its parameter group and the class of its scales:
    ``class StudyParameters(ScaledStudy[StudyScale], group="luo2016_study", kind=StudyScale)``.
    """

    scale: str  # name of the scale that is run
    scales: Mapping[str, Any]  # name of each scale to its fields

    _group: ClassVar[str]
    _kind: ClassVar[Any]

    def __init_subclass__(cls, *, group: str, kind: type, **options: Any) -> None:
        """Keep the name of the parameter group and the class of the scales."""
        super().__init_subclass__(**options)
        cls._group, cls._kind = group, kind

    def __post_init__(self) -> None:
        self.chosen_scale()

    def chosen_scale(self) -> Scale:
        """Return the scale that is run."""
        scale: Scale = chosen_scale(self._kind, self._group, self.scale, self.scales)
        return scale


def method_parameters(
    given: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """Return the parameters of methods, configured as mappings, with the changes of a scale."""
    made = {
        slug: METHODS[slug].load("parameters")(**values) if isinstance(values, Mapping) else values
        for slug, values in given.items()
    }
    return {slug: changed(own, (changes or {}).get(slug, {})) for slug, own in made.items()}


def changed(parameters: Any, changes: Mapping[str, Any]) -> Any:
    """Change fields of a parameter dataclass, nested ones field by field.

    Examples
    --------
    >>> from mlsroad_pipeline.papers.shared.patches.extraction import PatchParameters
    >>> changed(PatchParameters(), {"patch_size": 0.3}).patch_size
    0.3
    """
    known = {entry.name for entry in fields(parameters)}
    unknown = sorted(set(changes) - known)
    if unknown:
        raise ParameterError(f"{type(parameters).__name__} has no {', '.join(unknown)}")
    values = {}
    for name, value in changes.items():
        old = getattr(parameters, name)
        nested = is_dataclass(old) and isinstance(value, Mapping)
        values[name] = changed(old, value) if nested else value
    return replace(parameters, **values)
