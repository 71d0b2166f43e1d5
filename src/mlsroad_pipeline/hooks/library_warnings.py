"""Warnings of libraries that a user cannot act on."""

from __future__ import annotations

import warnings
from typing import TextIO

DOTS = "One or more dataset names contain '.'"
"""Kedro warns of dots at every command; here they serve catalog factories such as "{method}.labels"."""
TYPE_HINTS = "Add type hints to the `predict` method"
"""MLflow warns of a class of kedro-mlflow at its import; its own filters replace those of the process meanwhile."""


def silence() -> None:
    """Drop the two warnings above; all others are shown as before."""
    warnings.filterwarnings("ignore", message=DOTS, category=UserWarning)
    show = warnings.showwarning

    def show_others(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if TYPE_HINTS not in str(message):
            show(message, category, filename, lineno, file, line)

    warnings.showwarning = show_others
