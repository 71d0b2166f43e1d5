"""Connections of the page's server: a limited number, each of which must send its request in time."""

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_TIME = 10.0
"""Longest time from the first byte of a request, or from the connection, to its last byte, seconds."""

MOST_CONNECTIONS = 64
"""Number of connections from which the longest unfinished request is dropped; a browser opens six."""


class LimitedProtocol(H11Protocol):
    """HTTP/1.1 with a limit of connections and of the time of a request, which uvicorn does not have."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count the connection; of too many, the one that has waited longest for its request is closed."""
        super().connection_made(transport)
        self._watch()
        if len(self.connections) > MOST_CONNECTIONS:
            waiting = [other for other in self.connections if isinstance(other, LimitedProtocol) and other._deadline]
            longest = min(waiting, key=LimitedProtocol._ends)
            longest._stop()
            longest.transport.close()

    def data_received(self, data: bytes) -> None:
        """Pass data on; the time of a request ends with its last byte."""
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the time."""
        self._stop()
        super().connection_lost(exc)

    def _watch(self) -> None:
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._stop()
        elif self._deadline is None and not self.transport.is_closing():
            self._deadline = self.loop.call_later(REQUEST_TIME, self.transport.close)

    def _stop(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _ends(self) -> float:
        return self._deadline.when() if self._deadline is not None else float("inf")


OPTIONS: dict[str, Any] = {"http": LimitedProtocol, "ws": "none", "backlog": MOST_CONNECTIONS}
"""Options of uvicorn."""
