"""Local server of the page: Starlette on a loopback address."""

import json
import secrets
import socket
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError
from mlsroad_pipeline.review.page_server.access import Guard, RedirectFile
from mlsroad_pipeline.review.page_server.connections import OPTIONS
from mlsroad_pipeline.review.page_server.output_folder import REPORT, resolved
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey, one_line
from mlsroad_pipeline.review.page_server.tile_cache import CACHE, page_lock
from mlsroad_pipeline.review.page_server.tile_format import INDEX, LEVELS, level_file
from mlsroad_pipeline.review.page_server.wanted import area_of, size_of

LOOPBACK = "127.0.0.1"
STATIC = Path(str(files("mlsroad_pipeline.review.page_server"))) / "static"
"""Built client; its sources lie in `page/` of the repository."""

TILE_FILES = (INDEX, *(level_file(level) for level in range(LEVELS)))
REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
)
"""Policy of the report: its own scripts run without an origin, so that they cannot call the server."""
_SERVED = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}


def application(survey: ServedSurvey) -> Starlette:
    """Return the page of a survey, without the checks of `Guard`."""

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        yield
        survey.close()

    return Starlette(routes=[*_requests(survey), *_files(survey)], lifespan=lifespan)


def _requests(survey: ServedSurvey) -> list[Route]:
    """Return the routes whose answers are JSON; those of POST change the decisions or select points."""

    def number(request: Request) -> int:
        return max(0, min(int(request.query_params.get("number", "50")), 500))

    answers: dict[str, Callable[[Request], Any]] = {
        "survey": lambda request: survey.survey(),
        "status": lambda request: survey.status(),
        "corrections": lambda request: survey.corrections(),
        "states": lambda request: survey.corrections(points=False),
        "queue": lambda request: survey.queue(number(request)),
        "groups": lambda request: survey.point_groups(number(request)),
    }
    acts = {
        "decide": survey.decide,
        "undo": survey.undo,
        "paint": survey.paint,
        "group": survey.group,
        "leave-out": survey.leave_out,
        "deliver": survey.deliver,
    }
    return [
        *(Route(f"/api/{name}", _answer(value)) for name, value in answers.items()),
        *(Route(f"/api/{name}", _change(act), methods=["POST"]) for name, act in acts.items()),
    ]


def _files(survey: ServedSurvey) -> list[Route]:
    """Return the routes of points, pictures, the report and the client."""

    async def first(request: Request) -> Response:
        try:
            chunk = await run_in_threadpool(lambda: survey.first.chunk)
        except (MlsRoadError, OSError) as error:
            return _refused(error)
        return Response(chunk, media_type="application/octet-stream")

    async def tile(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in TILE_FILES or survey.tiles.index() is None:
            return PlainTextResponse("There is no such tile.\n", 404)
        return FileResponse(survey.tiles.folder / name, media_type="application/octet-stream")

    async def photo(request: Request) -> Response:
        path = resolved(survey.output.path, request.path_params["name"])
        kind = None if path is None else _SERVED.get(path.suffix.lower())
        if path is None or kind is None:
            return PlainTextResponse("There is no such file.\n", 404)
        return FileResponse(path, media_type=kind)

    async def background(request: Request) -> Response:
        query, shown = request.query_params, survey.background
        if shown is None:
            return PlainTextResponse("There is no background.\n", 404)
        try:
            area, size = area_of(query.get("area", "")), size_of(query.get("size", ""))
            content, kind = await run_in_threadpool(shown.picture, area, size)
        except MlsRoadError as error:
            return _refused(error)
        return Response(content, media_type=kind)

    async def report(request: Request) -> Response:
        path = resolved(survey.output.path, REPORT)
        if path is None:
            return PlainTextResponse("There is no report.\n", 404)
        headers = {"Content-Security-Policy": REPORT_POLICY}
        shown = survey.background
        if shown is None:
            return FileResponse(path, media_type="text/html", headers=headers)
        page = await run_in_threadpool(lambda: shown.report(path))
        return HTMLResponse(page, headers=headers)

    async def icon(request: Request) -> Response:
        return Response(status_code=204)  # the report names none, so that a browser asks for this one

    return [
        Route("/", _static("index.html")),
        Route("/favicon.ico", icon),
        Route("/first.bin", first),
        Route("/tiles/{name}", tile),
        Route("/files/{name:path}", photo),
        Route("/background", background),
        Route("/report", report),
        Route("/static/{name}", _static(None)),
    ]


def _static(fixed: str | None) -> Callable[[Request], Any]:
    async def static(request: Request) -> Response:
        path = resolved(STATIC, fixed or request.path_params["name"])
        if path is None:
            return PlainTextResponse("There is no such file.\n", 404)
        return FileResponse(path)

    return static


def _answer(value: Callable[[Request], Any]) -> Callable[[Request], Any]:
    """Return an endpoint whose answer is JSON; a known error is an answer with its message."""

    async def endpoint(request: Request) -> Response:
        try:
            return JSONResponse(await run_in_threadpool(value, request))
        except (MlsRoadError, OSError) as error:
            return _refused(error)
        except (ValueError, TypeError, OverflowError, RecursionError):
            return JSONResponse({"error": "the request is not understood"}, 400)

    return endpoint


def _refused(error: Exception) -> Response:
    return JSONResponse({"error": one_line(error)}, 409)


def _change(act: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[Request], Any]:
    """Return an endpoint that passes the JSON object of a request on."""

    async def endpoint(request: Request) -> Response:
        try:
            wanted = json.loads(await request.body())
            if not isinstance(wanted, dict):
                raise ValueError
        except (ValueError, RecursionError):
            return JSONResponse({"error": "the request is not a JSON object"}, 400)
        response: Response = await _answer(lambda request: act(wanted))(request)
        return response

    return endpoint


def serve(survey: ServedSurvey, *, port: int, browser: bool, show: Callable[[str], None]) -> None:
    """Serve the page of an output folder until the process is interrupted."""
    with page_lock(survey.output.path) as enter, _listening(port) as listener:
        survey.prepare()
        port = listener.getsockname()[1]
        token = secrets.token_urlsafe(32)
        enter(f"http://{LOOPBACK}:{port}/")
        address = f"http://{LOOPBACK}:{port}/?token={token}"
        start = _Start(address, survey.output.path / CACHE, browser=browser, show=show)
        guarded = Guard(application(survey), port=port, token=token, on_use=start.used)
        config = uvicorn.Config(
            guarded, log_level="warning", access_log=False, server_header=False, lifespan="on", **OPTIONS
        )
        server = _Server(config, start.announce)
        try:
            with suppress(KeyboardInterrupt):  # the usual end
                server.run(sockets=[listener])
        finally:
            start.end()
            survey.close()  # also where the server was ended before it had started
        show("The page is closed.")


class _Start:
    """Messages to the owner of the page: its address, the start of the browser, and the use of the token."""

    def __init__(self, address: str, folder: Path, *, browser: bool, show: Callable[[str], None]) -> None:
        self._address, self._folder, self._browser, self._show = address, folder, browser, show
        self._file: RedirectFile | None = None

    def announce(self) -> None:
        """Show the address and start the browser."""
        self._show(
            f"The page is at {self._address}\n"
            "The address is valid once. Ctrl-C ends the page; decisions are saved at once."
        )
        if self._browser:  # in a thread: a browser of the terminal returns when it ends
            threading.Thread(target=self._open, daemon=True).start()

    def _open(self) -> None:
        try:
            self._file = RedirectFile(self._address, self._folder)
            found = webbrowser.open(self._file.path.as_uri())
        except (webbrowser.Error, MlsRoadError, OSError) as error:
            self._show(f"No browser was started ({one_line(error)}): open this address in one.")
            return
        if not found:
            self._show("No browser was found: open this address in one.")

    def used(self) -> None:
        """Tell the owner that the address was used."""
        self._show("The address was used: a browser holds the page now. If it is not yours, end the page (Ctrl-C).")
        self.end()

    def end(self) -> None:
        """Remove the file of the browser."""
        if self._file is not None:
            self._file.remove()


class _Server(uvicorn.Server):
    """Server that calls a function when it accepts requests."""

    def __init__(self, config: uvicorn.Config, started: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_start = started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._on_start()


def _listening(port: int) -> socket.socket:
    """Return a socket on the loopback address; a port of 0 is any free one."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((LOOPBACK, port))
    except OSError as error:
        listener.close()
        raise PortError(
            f"port {port} of {LOOPBACK} cannot be used: {error.strerror}; choose another (--port)"
        ) from error
    return listener


class PortError(MlsRoadError):
    """The port is taken or not allowed."""
