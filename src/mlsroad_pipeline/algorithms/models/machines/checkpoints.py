"""Interface of the storage of training states."""

from __future__ import annotations

from typing import Any, Protocol


class Checkpoints(Protocol):
    """Storage of training states, one per training."""

    def load(self, name: str) -> dict[str, Any] | None:
        """Return a state, None if none was saved; raise ReadError if it is damaged."""

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Replace a state atomically."""

    def remove(self, name: str) -> None:
        """Remove a state if there is one."""

    def locate(self, name: str) -> str:
        """Return the place of a state for messages."""
