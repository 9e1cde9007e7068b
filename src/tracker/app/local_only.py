"""Lets in only this machine's own page: the loopback address, the session's token, requests of its own pages."""

from __future__ import annotations

import hmac
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

OWN_PAGE = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
REPORT = (  # a file with its scripts, pictures and styles in it; it can ask for nothing and has no origin
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; media-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts"
)


def make_redirect(address: str) -> str:
    """Make a page that leads this machine's browser to an address without characters that HTML escapes."""
    return f'<!DOCTYPE html><meta charset="utf-8"><meta http-equiv="refresh" content="0;url={address}">'


class LocalOnly:
    """Wraps the application and refuses what does not come from the page that the command has opened."""

    def __init__(self, app: ASGIApp, port: int, token: str, reports: str) -> None:
        self.app, self.token = app, token
        self.reports = f"/report/{reports}/"  # browsers send no cookie from a page without an origin, as reports are
        self.hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.cookie = f"workbench_{port}"  # browsers send cookies to every port of a host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        headers, path = Headers(scope=scope), scope["path"]
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        response: Response | None = None
        if headers.get("host", "") not in self.hosts:
            response = PlainTextResponse("this page answers to 127.0.0.1 alone", 403)
        elif path == "/" and self._is_token(given):
            response = HTMLResponse(make_redirect("/"))  # a 303 from a file's page would not send the strict cookie
            response.set_cookie(self.cookie, self.token, httponly=True, samesite="strict")
        elif path.startswith(self.reports) and scope["method"] in ("GET", "HEAD"):
            response = None
        elif not self._is_token(cookie_parser(headers.get("cookie", "")).get(self.cookie, "")):
            response = PlainTextResponse("open the address that `tracker open` has printed", 403)
        elif scope["method"] not in ("GET", "HEAD"):
            response = self._refuse_foreign(headers)

        async def send_finished(message: Message) -> None:
            if message["type"] == "http.response.start":
                out = MutableHeaders(scope=message)
                out["Content-Security-Policy"] = REPORT if path.startswith("/report/") else OWN_PAGE
                out["X-Content-Type-Options"] = "nosniff"
                out["Referrer-Policy"] = "no-referrer"
                out["Cross-Origin-Resource-Policy"] = "same-origin"
                out.setdefault("Cache-Control", "no-store")
            await send(message)

        await (response or self.app)(scope, receive, send_finished)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self.token.encode())

    def _refuse_foreign(self, headers: Headers) -> Response | None:
        """The refusal of a request that changes something and does not come from the page; None for the page's own."""
        if headers.get("origin", "") not in {f"http://{host}" for host in self.hosts}:
            return PlainTextResponse("a request of another page", 403)
        if headers.get("content-type", "") != "application/json":
            return PlainTextResponse("expected JSON", 415)
        length, max_bytes = headers.get("content-length", ""), 1 << 16
        if not length.isdecimal() or int(length) > max_bytes:
            return PlainTextResponse(f"expected at most {max_bytes} bytes", 413)
        return None
