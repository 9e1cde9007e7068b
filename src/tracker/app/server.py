"""The page's addresses, and the server of one session: it starts, opens the browser, and ends with the page."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp

from synthcam_shared.errors import InputError
from tracker.app.film_view import Look
from tracker.app.local_only import LocalOnly
from tracker.app.workbench import Workbench

STATIC = Path(__file__).with_name("static")
KINDS = {  # of the files that are served, by their endings
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".svg": "image/svg+xml",
    ".gif": "image/gif",
    ".webp": "image/webp",
    ".mp4": "video/mp4",
    ".webm": "video/webm",
}


class Presence:
    """Counts the pages that are open, to end the session when the last one is closed."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock, self.open, self.left_at = clock, 0, 0.0

    def enter(self) -> None:
        """A page is opened."""
        self.open += 1

    def leave(self) -> None:
        """A page is closed."""
        self.open -= 1
        self.left_at = self.clock()

    def is_over(self, grace_s: float = 5.0) -> bool:
        """True if pages were open, and none for so many seconds; a page that is loaded again takes less."""
        return self.open == 0 and self.left_at > 0 and self.clock() - self.left_at > grace_s


def make_application(
    bench: Workbench, port: int, token: str, ticket: str = "", presence: Presence | None = None
) -> ASGIApp:
    """The application of a session: all addresses of the page, behind `LocalOnly`, which explains token and ticket."""
    here = presence or Presence()

    def show_page(request: Request) -> Response:
        return _serve_file(STATIC, "index.html")

    def show_static(request: Request) -> Response:
        return _serve_file(STATIC, request.path_params["name"])

    def show_report(request: Request) -> Response:
        return _serve_file(bench.find_results(request.path_params["number"]), request.path_params["name"])

    def show_frame(request: Request) -> Response:
        kind, values = request.path_params["kind"], request.query_params
        if kind not in ("jpg", "png"):
            return _refuse(f"expected jpg or png, not {kind!r}", 404)
        try:
            box = tuple(int(part) for part in values["box"].split(",")) if "box" in values else None
            numbers = {name: float(values[name]) for name in ("low", "high") if name in values}
            reduce = int(values.get("reduce", "1"))
        except ValueError:
            raise InputError("expected numbers as low, high, reduce, box") from None
        if box is not None and len(box) != 4:
            raise InputError("box: expected left,top,width,height")
        look = Look(channel=values.get("channel", "grey"), reduce=reduce, box=box, **numbers)
        picture = bench.view.draw(request.path_params["index"], look, kind)
        return Response(picture, media_type=KINDS[f".{kind}"], headers={"Cache-Control": "private, max-age=3600"})

    def find_balls(request: Request) -> Response:
        found = bench.find_balls(request.path_params["index"])
        return JSONResponse(found) if found is not None else _refuse("the detector is being prepared", 409)

    def describe(request: Request) -> Response:
        return JSONResponse(bench.describe())

    def find_levels(request: Request) -> Response:  # apart, because it reads frames all over the film
        return JSONResponse(bench.view.levels)

    def describe_results(request: Request) -> Response:
        return JSONResponse(bench.describe_results(request.path_params["number"]))

    def list_tracks(request: Request) -> Response:
        return JSONResponse(bench.list_tracks(request.path_params["number"]))

    async def open_clip(request: Request) -> Response:
        index = await _read_body(request)
        if not isinstance(index, int) or isinstance(index, bool):
            raise InputError("clip: expected a whole number")
        await run_in_threadpool(bench.open_clip, index)
        return JSONResponse(await run_in_threadpool(bench.describe))

    async def apply(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(bench.apply, await _read_body(request)))

    async def start_run(request: Request) -> Response:
        await run_in_threadpool(bench.apply, await _read_body(request))
        return JSONResponse(await run_in_threadpool(bench.start_run))

    async def start_calibration(request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(bench.start_calibration, await _read_body(request)))

    async def cancel_run(request: Request) -> Response:
        bench.process.cancel()
        return JSONResponse(bench.describe_status())

    async def stream_status(request: Request) -> Response:
        async def tell() -> AsyncIterator[str]:
            here.enter()
            try:
                told, at = -1, 0.0
                while True:
                    if bench.version != told:
                        told = bench.version
                        yield f"data: {json.dumps(bench.describe_status())}\n\n"
                    elif time.monotonic() - at > 2:  # so that a closed page is noticed
                        at = time.monotonic()
                        yield ": here\n\n"
                    await asyncio.sleep(0.1)
            finally:
                here.leave()

        return StreamingResponse(tell(), media_type="text/event-stream")

    async def tell_error(request: Request, error: Exception) -> Response:
        return _refuse(f"{error}", 422)

    routes = [
        Route("/", show_page),
        Route("/static/{name}", show_static),
        Route("/report/{number:int}/{name:path}", show_report),
        Route("/frame/{index:int}.{kind}", show_frame),
        Route("/api/film", describe),
        Route("/api/levels", find_levels),
        Route("/api/balls/{index:int}", find_balls),
        Route("/api/results/{number:int}", describe_results),
        Route("/api/tracks/{number:int}", list_tracks),
        Route("/api/clip", open_clip, methods=["POST"]),
        Route("/api/settings", apply, methods=["POST"]),
        Route("/api/run", start_run, methods=["POST"]),
        Route("/api/calibrate", start_calibration, methods=["POST"]),
        Route("/api/cancel", cancel_run, methods=["POST"]),
        Route("/api/status", stream_status),
    ]
    return LocalOnly(Starlette(routes=routes, exception_handlers={InputError: tell_error}), port, token, ticket)


async def _read_body(request: Request) -> Any:
    try:
        return json.loads(await request.body())  # its size is checked by LocalOnly
    except (ValueError, RecursionError):
        raise InputError("expected JSON") from None


def _refuse(text: str, code: int) -> Response:
    return JSONResponse({"error": text}, code)


def _serve_file(folder: Path, name: str) -> Response:
    """A file of a folder, links resolved, if it is of a known kind; else 404."""
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()) or path.suffix not in KINDS or not path.is_file():
        return _refuse("no such file", 404)
    return FileResponse(path, media_type=KINDS[path.suffix])


def serve(bench: Workbench, browser: bool) -> None:
    """Serve the page on a free port of 127.0.0.1 until it is closed or Ctrl-C comes. Prints the address."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()  # before the address is known to anybody
        port, presence = listener.getsockname()[1], Presence()
        token, ticket = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        address = f"http://127.0.0.1:{port}/?token="
        server = uvicorn.Server(
            uvicorn.Config(
                make_application(bench, port, token, ticket, presence),
                log_level="critical",
                access_log=False,
                lifespan="off",
                ws="none",
                timeout_graceful_shutdown=1,
                server_header=False,
            )
        )
        over = threading.Event()

        def watch() -> None:
            while not over.wait(0.5):
                if presence.is_over() and not bench.process.is_running:
                    server.should_exit = True

        threading.Thread(target=watch, daemon=True).start()
        print(address + token, flush=True)
        print("tracker: close the page or press Ctrl-C to end", file=sys.stderr, flush=True)
        if browser and _has_screen():
            threading.Timer(0.3, webbrowser.open, (address + ticket,)).start()
        try:
            server.run(sockets=[listener])
        finally:
            over.set()
            bench.close()


def _has_screen() -> bool:
    """Tell whether a browser can show a page here: a text browser would take the terminal."""
    return not sys.platform.startswith("linux") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
