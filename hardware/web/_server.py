"""A small server of one page on this machine, only for those who have its address.

The address has a random token. A request without the token, under another host's name or
from another page gets an empty 403. The token matters because other pages and other users
of this machine can send requests, too.
"""

import asyncio
import json
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from tomojax._require import require

_BODY = 1024  # bytes of a request's body
_HEAD = 8192  # bytes of a request's headers
_IDLE = 20.0  # s that a connection may be silent
_CONNECTIONS = 32  # at once

_EVERY = 0.1  # s between looks at whether to end

_HEADERS = {
    # Scripts are this server's files: no inline ones, no `eval`. Bokeh sets styles.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'"
    " 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self'; base-uri 'none';"
    " form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}

_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
}


class Pages:
    """The pages to serve: `files` by name, and the answers of `answer` to `data?…`.

    `answer(asked)` returns a JSON object for the page's question; `asked` has names and
    texts. `mark(text)` marks a moment and returns its time, s. `mark` is None without a
    recorder.
    """

    def __init__(
        self,
        document: dict[str, Any],
        answer: Callable[[dict[str, str]], dict[str, Any]],
        mark: Callable[[str], float] | None = None,
    ):
        from bokeh.settings import settings  # an extra's

        here = Path(__file__).parent
        names = "page.html", "page.css", "page.js"
        self.files = {name: (here / name).read_bytes() for name in names}
        scripts = Path(settings.bokehjs_path(), "js")
        self.files["bokeh.min.js"] = (scripts / "bokeh.min.js").read_bytes()
        self.files["page.json"] = json.dumps(document).encode()
        self.answer, self.mark = answer, mark


def serve(
    pages: Pages,
    tell: Callable[[str], None],
    until: Callable[[], bool] = lambda: False,
    meanwhile: Callable[[], None] = lambda: None,
) -> None:
    """Serves until `until` says so; `tell` gets the page's address once it can be opened.

    `meanwhile` is called ten times a second.
    """
    asyncio.run(_serve(pages, tell, until, meanwhile))


async def _serve(pages, tell, until, meanwhile) -> None:
    from tornado.netutil import bind_sockets

    # Only an address of this machine's own: others cannot reach it.
    socket = bind_sockets(0, "127.0.0.1")[0]
    port, token = socket.getsockname()[1], secrets.token_urlsafe(16)
    server = _server(pages, port, token)
    server.add_socket(socket)
    tell(f"http://127.0.0.1:{port}/{token}/")
    try:
        while not until():
            meanwhile()
            await asyncio.sleep(_EVERY)
    finally:
        server.stop()


def _server(pages: Pages, port: int, token: str) -> Any:
    from tornado.httpserver import HTTPServer
    from tornado.web import Application

    class Bounded(HTTPServer):
        """A server with few connections: a new one replaces a stranger's oldest."""

        known: list[Any] = []

        def handle_stream(self, stream: Any, address: Any) -> None:
            streams = [one for one in self.known if not one.closed()]
            if len(streams) >= _CONNECTIONS:
                strangers = [s for s in streams if not getattr(s, "trusted", False)]
                oldest = (strangers or streams)[0]
                oldest.close()
                streams.remove(oldest)
            self.known[:] = [*streams, stream]
            super().handle_stream(stream, address)

    hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
    given = {"pages": pages, "token": token, "hosts": hosts}
    # What is asked for has the token in it: no log.
    application = Application(
        [(r"/.*", _handler(), given)], log_function=lambda handler: None
    )
    return Bounded(
        application,
        max_body_size=_BODY,
        max_header_size=_HEAD,
        max_buffer_size=1 << 16,
        chunk_size=1 << 12,
        idle_connection_timeout=_IDLE,
        body_timeout=_IDLE,
    )


def _handler() -> type:
    """Returns the handler's class; Tornado comes with Bokeh, which may not be installed."""
    from tornado.web import HTTPError, RequestHandler

    class Handler(RequestHandler):
        def initialize(self, pages: Pages, token: str, hosts: set[str]) -> None:
            self.pages, self.token, self.hosts = pages, token, hosts

        def set_default_headers(self) -> None:
            self.clear_header("Server")
            for name, value in _HEADERS.items():
                self.set_header(name, value)

        def prepare(self) -> None:
            asked, headers = self.request, self.request.headers
            hosts, origins = headers.get_list("Host"), headers.get_list("Origin")
            _, token, *rest = [*asked.path.split("/", 2), ""]
            fits = secrets.compare_digest(token.encode(), self.token.encode())
            fits &= len(hosts) == 1 and hosts[0] in self.hosts
            fits &= len(origins) <= 1
            fits &= all(origin == f"http://{hosts[0]}" for origin in origins)
            fits &= headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin")
            if not fits or asked.method not in ("GET", "POST"):
                raise HTTPError(403)
            setattr(asked.connection.stream, "trusted", True)  # noqa: B010  # pyright: ignore
            self.asked = rest[0]

        def get(self) -> None:
            name = self.asked or "page.html"
            if name == "data":
                asked = dict(parse_qsl(self.request.query)[:20])
                self._say(lambda: self.pages.answer(asked))
                return
            if name not in self.pages.files:
                raise HTTPError(404)
            self.set_header("Content-Type", _KINDS.get(Path(name).suffix, _JSON))
            self.finish(self.pages.files[name])

        def post(self) -> None:
            if self.asked != "mark":
                raise HTTPError(404)
            self._say(lambda: {"t": self._marked()})

        def _marked(self) -> float:
            require(self.pages.mark is not None, "mark", "no recording", "--record OUT")
            assert self.pages.mark is not None
            return self.pages.mark(self.request.body.decode(errors="replace"))

        def _say(self, made: Callable[[], dict[str, Any]]) -> None:
            self.set_header("Content-Type", _JSON)
            try:
                said = made()
            except ValueError as error:
                self.set_status(422)
                said = {"error": str(error)}
            self.finish(json.dumps(said, allow_nan=False))

        def write_error(self, status_code: int, **_: Any) -> None:
            self.clear_header("Content-Type")
            self.finish()

        def log_exception(self, typ: Any, value: Any, tb: Any) -> None:
            if not isinstance(value, HTTPError):
                print(f"tomojax: page: {' '.join(str(value).split())}", flush=True)

    return Handler


_JSON = "application/json"


def quiet() -> None:
    """Keeps what strangers send out of the terminal."""
    import logging

    logging.getLogger("tornado").setLevel(logging.CRITICAL)
