"""Log records without control characters, and without warnings of libraries that a user cannot act on.

Names of files may hold characters that move the cursor or forge lines.
"""

import logging
import warnings
from pathlib import PurePath
from typing import Any

from kedro.framework.hooks import hook_impl

from mlsroad_pipeline.algorithms.core.plain_text import printable

DOTS = "One or more dataset names contain '.'"
"""Kedro warns of dots at every command; here they serve catalog factories such as "{method}.labels"."""
TYPE_HINTS = "Add type hints to the `predict` method"
"""MLflow warns of a class of kedro-mlflow at its import; its own filters replace those of the process meanwhile."""
RESOLVERS = r"register_new_resolver\(\) is deprecated"
"""OmegaConf 2.4 warns of a call of Kedro 1.7 and kedro-mlflow 2.0 in every session."""
NO_SYSTEM = ".*crs.* was not provided"
"""pyogrio warns of layers without a system; filters around the call are lost where Numba compiles in another thread."""


def silence() -> None:
    """Drop the warnings above, most of which precede the first hook; all others are shown as before."""
    for message in (DOTS, RESOLVERS, NO_SYSTEM):
        warnings.filterwarnings("ignore", message=message, category=UserWarning)
    show = warnings.showwarning

    def show_others(message: Warning | str, *rest: Any, **named: Any) -> None:
        if TYPE_HINTS not in str(message):
            show(message, *rest, **named)

    warnings.showwarning = show_others


_PACKAGE = "mlsroad_pipeline"


def _plain(value: Any) -> Any:
    """Return an argument of a record; texts such as tracebacks keep their lines."""
    if isinstance(value, PurePath):
        return printable(value)
    if isinstance(value, str) and not value.isprintable():
        return "\n".join(printable(line) if not line.isprintable() else line for line in value.split("\n"))
    return value


def install() -> None:
    """Make all further records of the package plain, once."""
    make = logging.getLogRecordFactory()
    if getattr(make, "is_plain", False):
        return

    def plain_record(*args: Any, **kwargs: Any) -> logging.LogRecord:
        record = make(*args, **kwargs)
        if record.name.startswith(_PACKAGE) and isinstance(record.args, tuple):
            record.args = tuple(_plain(value) for value in record.args)
        return record

    plain_record.is_plain = True  # type: ignore[attr-defined]  # a mark on the function
    logging.setLogRecordFactory(plain_record)


class PlainLogsHooks:
    """Make records plain before the first names of files are read."""

    @hook_impl(tryfirst=True)
    def after_context_created(self) -> None:
        """Install the factory of records; a further session of this process changes nothing."""
        install()
