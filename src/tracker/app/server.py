"""The page's addresses, and the server of one session: it starts, opens the browser, and ends with the page."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable
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
from tracker.app.film_view import PictureLook
from tracker.app.local_only import LocalOnly, make_redirect
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


class OpenPages:
    """Counts the pages that are open, to end the session when the last one is closed."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock, self.open, self.left_at, self.asked = clock, 0, 0.0, False

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


class SessionAddresses:
    """All addresses of a session's page, and what answers the requests to each."""

    def __init__(self, bench: Workbench, presence: OpenPages) -> None:
        self.bench, self.presence = bench, presence

    def list_routes(self) -> list[Route]:
        """Each address with the function that answers it."""
        bench = self.bench
        asked: dict[str, Callable[..., Any]] = {  # what the page asks for; the numbers in an address are arguments
            "film": bench.describe,
            "levels": lambda: bench.view.levels,  # apart from the film, because they need frames all over it
            "results/{number:int}": bench.describe_results,
            "tracks": bench.describe_tracks,
            "searched/{number:int}": bench.describe_search,
        }
        sent: dict[str, Callable[[Any], Any]] = {  # what takes the values that the page sends
            "clip": self.open_clip,
            "settings": bench.apply,
            "run": self.start_run,
            "calibrate": bench.start_calibration,
            "edits": bench.mend,
            "combine": lambda _: bench.start_combination(),
            "search": bench.start_search,
            "preview": bench.previews.ask,
            "generate": bench.start_generation,
            "cancel": self.cancel_run,
        }
        return [
            Route("/", self.show_page),
            Route("/static/{name}", lambda request: _serve_file(STATIC, request.path_params["name"])),
            Route("/report/{key}/{number:int}/{name:path}", self.show_report),
            Route("/frame/{index:int}.{kind}", self.show_frame),
            Route("/api/balls/{index:int}", self.find_balls),
            Route("/api/status", self.stream_status),
            *(Route(f"/api/{name}", _answer(find)) for name, find in asked.items()),
            *(Route(f"/api/{name}", _answer_body(take), methods=["POST"]) for name, take in sent.items()),
        ]

    def show_page(self, request: Request) -> Response:
        """The page itself."""
        self.presence.asked = True
        return _serve_file(STATIC, "index.html")

    def show_report(self, request: Request) -> Response:
        """A file of a run's results, such as its report."""
        return _serve_file(self.bench.find_page_folder(request.path_params["number"]), request.path_params["name"])

    def show_frame(self, request: Request) -> Response:
        """A picture of one frame; the query gives the channel, the levels, the reduction and the box."""
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
        look = PictureLook(channel=values.get("channel", "grey"), reduce=reduce, box=box, **numbers)
        picture = self.bench.view.draw(request.path_params["index"], look, kind)
        return Response(picture, media_type=KINDS[f".{kind}"], headers={"Cache-Control": "private, max-age=3600"})

    def find_balls(self, request: Request) -> Response:
        """The balls that the detector finds in one frame."""
        found = self.bench.find_balls(request.path_params["index"])
        return JSONResponse(found) if found is not None else _refuse("the detector is being prepared", 409)

    def open_clip(self, index: Any) -> dict[str, Any]:
        """Show another clip of the film."""
        if not isinstance(index, int) or isinstance(index, bool):
            raise InputError("clip: expected a whole number")
        self.bench.open_clip(index)
        return self.bench.describe()

    def start_run(self, values: Any) -> dict[str, Any]:
        """Use these settings, and track the film with them."""
        self.bench.apply(values)
        return self.bench.start_run()

    def cancel_run(self, _: Any) -> dict[str, Any]:
        """Stop the run."""
        self.bench.process.cancel()
        return self.bench.describe_status()

    async def stream_status(self, request: Request) -> Response:
        """The status of the session, sent at each change for as long as the page is open."""
        return StreamingResponse(self._yield_status(), media_type="text/event-stream")

    async def _yield_status(self) -> AsyncIterator[str]:
        self.presence.enter()
        try:
            sent_version, sent_at = -1, 0.0
            while True:
                if self.bench.version != sent_version:
                    sent_version = self.bench.version
                    yield f"data: {json.dumps(self.bench.describe_status())}\n\n"
                elif time.monotonic() - sent_at > 2:  # so that a closed page is noticed
                    sent_at = time.monotonic()
                    yield ": here\n\n"
                await asyncio.sleep(0.1)
        finally:
            self.presence.leave()


def make_application(bench: Workbench, port: int, token: str, presence: OpenPages | None = None) -> ASGIApp:
    """Build the web application of a session: all addresses of the page, behind `LocalOnly`."""
    routes = SessionAddresses(bench, presence or OpenPages()).list_routes()
    application = Starlette(routes=routes, exception_handlers={InputError: _explain_error})
    return LocalOnly(application, port, token, bench.report_key)


def _answer(find: Callable[..., Any]) -> Callable[[Request], Response]:
    """The answer to a request: what a function finds for the numbers in the address."""
    return lambda request: JSONResponse(find(**request.path_params))


def _answer_body(take: Callable[[Any], Any]) -> Callable[[Request], Awaitable[Response]]:
    """The answer to a request with a body, whose size `LocalOnly` has checked."""

    async def answer(request: Request) -> Response:
        try:
            body = json.loads(await request.body())
        except (ValueError, RecursionError):
            raise InputError("expected JSON") from None
        return JSONResponse(await run_in_threadpool(take, body))

    return answer


async def _explain_error(request: Request, error: Exception) -> Response:
    return _refuse(f"{error}", 422)


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
        port, presence = listener.getsockname()[1], OpenPages()
        token = secrets.token_urlsafe(24)
        address = f"http://127.0.0.1:{port}/?token={token}"
        server = uvicorn.Server(
            uvicorn.Config(
                make_application(bench, port, token, presence),
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
        print(address, flush=True)
        print("tracker: close the page or press Ctrl-C to end", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory(prefix="workbench_") as own:  # its files are for this user alone
            if browser and _has_screen():
                page = write_opening_page(Path(own), address)
                threading.Thread(target=remind_of_address, args=(presence, over), daemon=True).start()
                threading.Timer(0.3, webbrowser.open, (page.as_uri(),)).start()
            try:
                server.run(sockets=[listener])
            finally:
                over.set()
                bench.close()


def remind_of_address(presence: OpenPages, over: threading.Event, wait_s: float = 5.0) -> None:
    """Say where the page is if no browser has asked for it: some may not read the file that they are to open."""
    if not over.wait(wait_s) and not presence.asked:
        print("tracker: no page has connected: open the address above", file=sys.stderr, flush=True)


def write_opening_page(folder: Path, address: str) -> Path:
    """Write the file that a browser opens: all users of a machine see the words of commands, but not this file."""
    page = folder / "open.html"
    page.touch(0o600)
    page.write_text(make_redirect(address))
    return page


def _has_screen() -> bool:
    """Tell whether a browser can show a page here: a text browser would take the terminal."""
    return not sys.platform.startswith("linux") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
