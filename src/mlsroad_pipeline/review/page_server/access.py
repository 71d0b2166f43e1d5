"""Access to the page: one-time token and its file, session cookie, checks of host and origin, headers."""

import hmac
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mlsroad_pipeline.algorithms.core.exceptions import ReadError

_CONTENT = """<!DOCTYPE html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0;url={address}">
<title>mlsroad</title>
<p><a href="{address}">Open the page</a></p>
"""


def redirect_to(address: str = "/") -> str:
    """Return a document that goes on to an address."""
    return _CONTENT.format(address=address)


class RedirectFile:
    """A file of mode 0600 that goes on to an address; it is removed when the address was used."""

    def __init__(self, address: str, folder: Path) -> None:
        number, name = tempfile.mkstemp(prefix="open-", suffix=".html", dir=folder.absolute())
        self.path = Path(name)
        with os.fdopen(number, "w", encoding="utf-8") as stream:
            mode = stat.S_IMODE(os.fstat(number).st_mode)
            if not mode & 0o077:
                stream.write(redirect_to(address))
        if mode & 0o077:  # a file system without permissions
            self.remove()
            raise ReadError(f"{folder} does not keep permissions, so that others could read the address of the page")

    def remove(self) -> None:
        """Remove the file."""
        self.path.unlink(missing_ok=True)


POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "frame-ancestors 'none'",
        "base-uri 'none'",
        "form-action 'none'",
    )
)
"""Content security policy of the page: nothing inline, no `eval`, nothing from the network."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
}
UNKNOWN = "Open the address that `mlsroad open` printed. It is valid once: start the command again for another.\n"
METHODS = ("GET", "HEAD", "POST")
LARGEST_BODY = 1 << 20
"""Largest body of a request, bytes."""


GO = "/go"
"""Path of links of the report, which has no origin: its answer holds nothing but the way to the page, which asks for
the cookie."""
_TARGET = re.compile(r"(object|line|place)=[-0-9.,]{1,80}")


class Guard:
    """ASGI application that passes only requests of the page itself."""

    def __init__(self, app: ASGIApp, *, port: int, token: str, on_use: Callable[[], None] = lambda: None) -> None:
        self._app, self._on_use = app, on_use
        self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self._origins = tuple(f"http://{host}" for host in self._hosts)
        self._cookie = f"mlsroad_{port}"
        self._foreign_host = (
            f"This host name is not served. For a forwarded port: ssh -L {port}:127.0.0.1:{port} HOST\n"
        )
        self._token: str | None = token
        self._session = secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":  # no websocket is served
            return
        request = Request(scope)
        granted = scope["method"] == "GET" and request.url.path == "/" and self._is_token(request.query_params)
        is_link = scope["method"] == "GET" and request.url.path == GO
        refused = self._foreign(scope["method"], request.headers, from_file=granted or is_link)
        if refused is not None:
            await PlainTextResponse(refused, 403)(scope, receive, _with_headers(send, {}))
            return
        if granted:
            self._token = None
            cookie = f"{self._cookie}={self._session}; Path=/; HttpOnly; SameSite=Strict"
            # A document and no redirection: a browser sends a strict cookie only where the request comes from the page.
            await HTMLResponse(redirect_to())(scope, receive, _with_headers(send, {"set-cookie": cookie}))
            self._on_use()
            return
        if is_link:
            await HTMLResponse(redirect_to(f"/#{_target(request.url.query)}"))(scope, receive, _with_headers(send, {}))
            return
        if not self._known(request.cookies):
            await PlainTextResponse(UNKNOWN, 401)(scope, receive, _with_headers(send, {}))
            return
        await self._app(scope, receive, _with_headers(send, {}))

    def _foreign(self, method: str, headers: Headers, *, from_file: bool) -> str | None:
        """Return why a request does not come from the page, None if it may; one with a token comes from a file.

        So may one that follows a link of the report.
        """
        if headers.get("host") not in self._hosts:
            return self._foreign_host
        origin = headers.get("origin")
        if origin is not None and origin not in self._origins:
            return "Requests of other pages are refused.\n"
        if not from_file and headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "Requests of other pages are refused.\n"
        if method not in METHODS:
            return "This method is not served.\n"
        return _unfit(headers) if method == "POST" else None

    def _is_token(self, given: Mapping[str, str]) -> bool:
        """Return whether a query has the token, which is valid once."""
        return self._token is not None and hmac.compare_digest(given.get("token", "").encode(), self._token.encode())

    def _known(self, cookies: Mapping[str, str]) -> bool:
        return hmac.compare_digest(cookies.get(self._cookie, "").encode(), self._session.encode())


def _target(query: str) -> str:
    """Return the object, line or place of a link; empty for anything else."""
    return query if _TARGET.fullmatch(query) else ""


def _unfit(headers: Headers) -> str | None:
    """Return why a change is refused, None if it is not."""
    if "origin" not in headers or headers.get("content-type", "").partition(";")[0] != "application/json":
        return "A change needs an origin and JSON.\n"
    length = headers.get("content-length", "")
    if not length.isdigit() or int(length) > LARGEST_BODY:
        return "The body of the request is too large, or its length is missing.\n"
    return None


def _with_headers(send: Send, more: Mapping[str, str]) -> Callable[[Message], Awaitable[None]]:
    async def with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers[name] = value
            headers.setdefault("Content-Security-Policy", POLICY)
            headers.setdefault("Cache-Control", "no-store")
            for name, value in more.items():
                headers.append(name, value)
        await send(message)

    return with_headers
