"""Parameters that hold groups of parameters, as configuration and stored models give them: mappings."""

from __future__ import annotations

from collections.abc import Callable, Mapping


def parse_groups(parameters: object, **kinds: Callable[..., object]) -> None:
    """Replace mappings among the fields of frozen parameters by instances of their classes.

    Parameters
    ----------
    parameters : dataclass
        The parameters, in their `__post_init__`.
    **kinds : type
        Class of each field that is a group; a field that is an instance already is kept.

    Raises
    ------
    TypeError
        If a mapping has an unknown name.
    """
    for name, kind in kinds.items():
        given = getattr(parameters, name)
        if isinstance(given, Mapping):
            object.__setattr__(parameters, name, kind(**given))
