"""Parameters that hold groups of parameters, as configuration and stored models give them: mappings."""

from collections.abc import Callable, Mapping


def parse_groups(parameters: object, **kinds: Callable[..., object]) -> None:
    """Replace mappings among the fields of frozen parameters by instances of their classes."""
    for name, kind in kinds.items():
        given = getattr(parameters, name)
        if isinstance(given, Mapping):
            object.__setattr__(parameters, name, kind(**given))
