"""Serves the page and its data on one address: static files, JSON, and a WebSocket for what changes.

Nobody else gets in: the address holds a random token, requests must name this host, and those of other origins are
refused. People may have addresses with tokens of their own, which can do less. The page may load nothing from elsewhere
and run no script but its own files.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from ipaddress import ip_address
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import urlsplit

from fame.closing import Closing
from fame.errors import ConfigError, FameError
from fame.fast_json import json_bytes
from fame.imports import require
from fame.text import printable, read_json
from fame.view.people import Person

if TYPE_CHECKING:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket

    from fame.bpmn.model import Human

LOOPBACK = "127.0.0.1"
POLL = 0.04
"""Seconds between two looks at what is new, for each page."""
BEAT = 1.0
"""Seconds without news after which a page gets a beat: without any it knows that what it shows is old."""
LONGEST = 1_000_000
"""Bytes of a command, at most."""
RARE = 10.0
"""Seconds between two notes of refused requests in the logs of robots."""
PATIENCE = 10.0
"""Seconds in which a connection has to make its first request; then it is closed."""
WAITING = 100
"""Connections that have made no request yet, at most; of more the oldest ones are closed."""
_BACKLOG = 64
"""Connections that wait to be accepted: asyncio accepts as many at once, before it looks at any."""
_WHO = 100
"""Characters of what somebody else wrote, at most."""
_KINDS = {
    ".webmanifest": "application/manifest+json",
    ".html": "text/html",
    ".js": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".woff2": "font/woff2",
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "font-src 'self'; connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class PageSource(Protocol):
    """What a page shows. All methods may be called from any thread.

    LookupError itself says that there is no such thing; a KeyError or IndexError is a fault of the source.
    """

    def mission(self) -> Mapping[str, Any]:
        """Everything that the page needs first: robots, elements, planes, world, blocks."""

    def plane(self, number: int) -> Mapping[str, Any]:
        """Return a drawing. Raises LookupError."""

    def block(self, number: int) -> Mapping[str, Any] | bytes:
        """Return a block, or its JSON. Raises LookupError."""

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        """Return what is new for a page that has `known` (at first None), and what it has afterwards."""

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """Carry out a command of the page; ``who`` names the person, if the page is one's own. Raises FameError."""

    def tasks(self, element: str) -> Iterable[Human]:
        """Return what the tasks with an id say of people, in all models."""


class Server(Closing):
    """The page of a `source` at a free port of `host`, or `port`, served by a thread until it is closed.

    `tls`: files of a certificate and its private key, with which the page is encrypted.
    `people` have addresses of their own: there they can only do what is theirs (`Person.check`). Raises ConfigError
    for a port that is not free.
    """

    people: tuple[Person, ...]
    source: PageSource
    host: str
    port: int
    token: str
    socket: socket.socket

    def __init__(
        self,
        source: PageSource,
        *,
        host: str = LOOPBACK,
        port: int = 0,
        people: Sequence[Person] = (),
        tls: tuple[Path, Path] | None = None,
    ) -> None:
        require("starlette", "uvicorn", "websockets")
        self._tls = tls
        if tls is not None:
            _check_certificate(*tls)
        self.source, self.token, self.people = source, secrets.token_urlsafe(18), tuple(people)
        self.socket = _bound(host, port)
        self.host, self.port = host, self.socket.getsockname()[1]
        self._server = self._made()
        self._thread = threading.Thread(target=self._serve, name="fame view: server", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The address of the page."""
        return self._address(self.token)

    @property
    def addresses(self) -> dict[Person, str]:
        """The addresses of the people."""
        return {person: self._address(person.token) for person in self.people}

    def _address(self, token: str) -> str:
        return f"http{'s' if self._tls else ''}://{_in_address(self.host)}:{self.port}/{token}/"

    def _made(self) -> uvicorn.Server:
        import uvicorn

        refusals = _RefusalLog(self.source)
        config = uvicorn.Config(
            self.app(refusals),
            http=_bounded(refusals),
            backlog=_BACKLOG,
            log_level="error",
            lifespan="off",
            ws="websockets-sansio",
            timeout_graceful_shutdown=1,
        )
        if self._tls is not None:
            config.ssl_certfile, config.ssl_keyfile = map(str, self._tls)
        return uvicorn.Server(config)

    def _serve(self) -> None:
        with self.socket:
            self._server.run(sockets=[self.socket])

    def close(self) -> None:
        """Stop serving, also before it has begun."""
        self._server.should_exit = True
        self._thread.join()

    def app(self, refusals: _RefusalLog | None = None) -> ASGIApp:
        """Return the application, behind its guard."""
        tokens = {self.token: None, **{person.token: person for person in self.people}}
        refusals, scheme = refusals or _RefusalLog(self.source), "https" if self._tls else "http"
        return _Guard(_Endpoints(self.source, refusals).application(), tokens, self.host, self.port, scheme, refusals)


def _check_certificate(certificate: Path, key: Path) -> None:
    """Raise ConfigError for files that are no certificate with its private key."""
    import ssl

    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=lambda: "")
    except OSError as error:  # SSLError is one, too
        text = f"expected a certificate and its private key without a password (PEM), {certificate} and {key}"
        raise ConfigError(f"--tls: {text}: {error.strerror or error}") from None


def _bound(host: str, port: int) -> socket.socket:
    bound: socket.socket | None = None
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        # asyncio sets TCP_NODELAY only where the protocol is named: without it, the end of an answer comes 40 ms late
        bound = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
        bound.listen(_BACKLOG)  # who comes before `run` waits
    except (OSError, OverflowError, ValueError) as error:  # the latter two: not a port, not the name of a host
        if bound is not None:
            bound.close()
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot serve the page on {host} port {port}: {reason}") from None
    return bound


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host


# ---- who gets in -----------------------------------------------------------------------------------------------------


class _RefusalLog:
    """Notes requests that were refused in the log of each robot: at most once in `RARE` seconds."""

    def __init__(self, source: PageSource) -> None:
        self._source = source
        self._next = 0.0
        self._unsaid = 0

    def add(self, what: str, who: str) -> None:
        """Note that somebody (`who`) asked for something; by another thread, since robots have to answer."""
        if monotonic() < self._next:
            self._unsaid += 1
            return
        more, self._unsaid = f" (and {self._unsaid} more before)" if self._unsaid else "", 0
        self._next = monotonic() + RARE
        command = {"do": "note", "text": f"{what} refused{more}, asked for", "who": printable(who[:_WHO])}
        threading.Thread(target=self._note, args=(command,), daemon=True).start()

    def _note(self, command: Mapping[str, Any]) -> None:
        for robot in self._source.mission().get("robots", ()):
            with suppress(Exception):  # of a page without control, or a robot that has left
                self._source.control({**command, "robot": robot["name"]})


def _bounded(refusals: _RefusalLog) -> type[asyncio.Protocol]:
    """The HTTP protocol of a server that closes connections without a request: one client cannot shut others out."""
    from uvicorn.protocols.http.auto import AutoHTTPProtocol

    waiting: dict[Any, None] = {}  # the oldest first

    def on_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if isinstance(context.get("exception"), OSError):  # the process may not have more files: it accepts later
            refusals.add("connections beyond what the process may have open", "somebody")
        else:
            loop.default_exception_handler(context)

    class Bounded(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            self.loop.set_exception_handler(on_error)
            waiting[self] = None
            self.loop.call_later(PATIENCE, self.expire)
            if len(waiting) > WAITING:
                next(iter(waiting)).expire()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.cycle is not None or self.transport.get_protocol() is not self:  # a request, or a WebSocket
                waiting.pop(self, None)

        def connection_lost(self, error: Exception | None) -> None:
            waiting.pop(self, None)
            super().connection_lost(error)

        def expire(self) -> None:
            """Close the connection unless it has made a request."""
            if self in waiting:
                del waiting[self]
                refusals.add("a connection without a request", str(self.client[0] if self.client else "somebody"))
                self.transport.abort()

    return Bounded


class _Guard:
    """Accepts requests that have the token, name this host, and come from this page or from no page."""

    def __init__(
        self,
        app: ASGIApp,
        tokens: Mapping[str, Person | None],
        host: str,
        port: int,
        scheme: str,
        refusals: _RefusalLog,
    ) -> None:
        self._app, self._tokens, self._port, self._scheme = app, tokens, port, scheme
        self._refusals = refusals
        self._names = {host.lower(), *(("localhost", LOOPBACK, "::1") if _is_loopback(host) else ())}
        self._any_name = host in ("0.0.0.0", "::")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status = self._refusal(scope)
        if not status:
            token = _token_of(scope)
            inner = dict(scope, path=scope["path"][len(token) + 1 :], person=self._tokens[token])
            inner["raw_path"] = inner["path"].encode()
            inner["root_path"] = ""
            await self._app(inner, receive, send)
        else:
            if status != 404:  # of a page elsewhere, or of another name for this host
                headers = dict(scope["headers"])
                origin = headers.get(b"origin", b"another origin").decode("latin-1")
                self._refusals.add(f"a {'command' if scope.get('method') == 'POST' else 'request'} to the page", origin)
            await _refuse(scope, send, status)

    def _refusal(self, scope: Scope) -> int:
        """The status that a request is refused with, or 0."""
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        if not self._is_here(headers.get(b"host", "")):
            return 421
        origin = headers.get(b"origin")
        needs_origin = scope["type"] == "websocket" or scope.get("method") not in ("GET", "HEAD")
        if origin is None and needs_origin and b"sec-fetch-site" in headers:
            return 403
        parts = urlsplit(origin or "")
        if origin is not None and (parts.scheme != self._scheme or not self._is_here(parts.netloc)):
            return 403
        if origin is not None and parts.netloc.lower() != headers[b"host"].lower():
            return 403
        given = _token_of(scope).encode()
        return 0 if sum(secrets.compare_digest(given, token.encode()) for token in self._tokens) else 404

    def _is_here(self, netloc: str) -> bool:
        """Whether an address names this server: a page of another name that resolves to this host does not."""
        try:
            parts = urlsplit(f"//{netloc}")
            name, port = (parts.hostname or "").lower(), parts.port or (443 if self._scheme == "https" else 80)
        except ValueError:
            return False
        return port == self._port and (name in self._names or (self._any_name and _is_number(name)))


class _OwnPage:
    """Serves the page that may do everything, and nobody else."""

    def __init__(self, app: ASGIApp, refusals: _RefusalLog) -> None:
        self._app, self._refusals = app, refusals

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["person"] is None:
            await self._app(scope, receive, send)
        else:
            self._refusals.add("the page of a changed model", str(scope["person"]))
            await _refuse(scope, send, 403)


async def _refuse(scope: Scope, send: Send, status: int) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
    else:
        await send(
            {"type": "http.response.start", "status": status, "headers": _raw({**_HEADERS, "Connection": "close"})}
        )
        await send({"type": "http.response.body", "body": _REFUSALS[status].encode()})


def _token_of(scope: Scope) -> str:
    """The first part of the path of a request."""
    path = str(scope["path"]).split("/", 2)
    return path[1] if len(path) == 3 else ""


_REFUSALS = {
    403: "This page answers only itself.\n",
    404: "Nothing here. Open the whole address that fame printed, with its token.\n",
    421: "This server has another name.\n",
}


def _is_loopback(host: str) -> bool:
    return host == "localhost" or host == "::1" or host.startswith("127.")


def _is_number(host: str) -> bool:
    """Whether a host is an IP address: names could be rebound to this server by a foreign page."""
    with suppress(ValueError):
        return bool(ip_address(host))
    return False


def _raw(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.lower().encode(), value.encode()) for name, value in headers.items()]


# ---- what they get ---------------------------------------------------------------------------------------------------


class _Endpoints:
    """What one page is answered: its files, JSON of its source, commands, and a WebSocket for what is new."""

    def __init__(self, source: PageSource, refusals: _RefusalLog) -> None:
        self._source = source
        self._refusals = refusals
        self._files = files("fame.view") / "page"

    def application(self) -> Starlette:
        """Return all routes; below ``/change`` and ``/run`` those of the source's other pages, if it has them."""
        from starlette.applications import Starlette
        from starlette.routing import Mount, Route, WebSocketRoute

        source = self._source
        others: dict[str, PageSource | None] = {name: getattr(source, name, None) for name in ("change", "run")}
        inner = {
            name: _OwnPage(_Endpoints(other, self._refusals).application(), self._refusals)
            for name, other in others.items()
            if other is not None
        }
        return Starlette(
            routes=[
                *(Mount(f"/{name}", other) for name, other in inner.items()),
                Route("/", self._static),
                Route("/page/{name:path}", self._static),
                Route("/mission.json", self._mission),
                Route("/plane/{number:int}.json", _json_of(source.plane)),
                Route("/block/{number:int}.json", _json_of(source.block)),
                Route("/at/{time:int}.json", _json_of(getattr(source, "at", _nothing))),
                Route("/control", self._control, methods=["POST"]),
                WebSocketRoute("/live", self._live),
            ]
        )

    async def _static(self, request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        kind, content = _KINDS.get(Path(name).suffix), await asyncio.to_thread(self._file, name)
        return _not_found("no such file\n") if kind is None or content is None else _response(content, kind)

    def _file(self, name: str) -> bytes | None:
        """A file of the page, which its source may replace, and add to."""
        own = getattr(self._source, "file", _no_file)(name)
        found = self._files / name
        return own if own is not None else found.read_bytes() if "/" not in name and found.is_file() else None

    async def _mission(self, request: Request) -> Response:
        mission, person = dict(await asyncio.to_thread(self._source.mission)), request.scope["person"]
        if person is not None:
            theirs = [act for act in mission.get("control", ()) if act in ("complete", *person.acts)]
            mission |= {"person": person.to_json(), "control": theirs}
        return _json(mission)

    async def _control(self, request: Request) -> Response:
        try:
            longest = getattr(self._source, "longest", LONGEST)
            text = await _body(request, longest)
            if text is None:
                return _json({"error": f"longer than {longest} bytes"}, 413)
            command = read_json(text, longest)
            if not isinstance(command, dict):
                raise ValueError
            return _json(await asyncio.to_thread(self._obey, command, request.scope["person"]))
        except FameError as error:
            return _json({"error": str(error)}, 409)
        except Exception:  # of whatever a page sends
            return _json({"error": "not a command"}, 400)

    def _obey(self, command: Mapping[str, Any], person: Person | None) -> Mapping[str, Any]:
        """Carry out a command of the page of a person, or of the page that may do everything."""
        who = {"who": str(person)} if person is not None else {}
        if person is not None:
            try:
                person.check(command, self._source.tasks(str(command.get("element", ""))))
            except FameError as error:
                text = f"{command.get('do')} refused: {error}, asked for"
                try:
                    self._source.control({"do": "note", "robot": command.get("robot"), "text": text} | who)
                except Exception:  # of a page without control, or an unknown robot
                    self._refusals.add(str(command.get("do"))[:_WHO], str(person))
                raise
        return self._source.control({name: value for name, value in command.items() if name != "who"} | who)

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept()
        with suppress(Exception):  # of a page that has gone, whatever its connection raises: it connects again
            await _send_news(socket, self._source)


def _json_of(make: Callable[..., Mapping[str, Any] | bytes]) -> Callable[[Request], Any]:
    """Make the endpoint of a part of the source, which the numbers in the path name."""

    async def endpoint(request: Request) -> Response:
        try:
            part = await asyncio.to_thread(make, *request.path_params.values())
        except LookupError as error:
            if type(error) is not LookupError:  # a fault of the source
                raise
            return _not_found("no such thing\n")
        return _json(part)

    return endpoint


def _json(content: Mapping[str, Any] | bytes, status: int = 200) -> Response:
    return _response(content if isinstance(content, bytes) else json_bytes(content), "application/json", status)


def _not_found(text: str) -> Response:
    return _response(text.encode(), "text/plain", 404)


def _response(content: bytes, kind: str, status: int = 200) -> Response:
    from starlette.responses import Response

    return Response(content, status, _HEADERS, kind)


async def _body(request: Request, longest: int) -> str | None:
    """The body of a request; None if it is too long, without reading the rest. Raises ValueError."""
    found = bytearray()
    async for part in request.stream():
        found += part
        if len(found) > longest:
            return None
    return found.decode()


def _no_file(name: str) -> bytes | None:
    """A source has no files of its own, unless it says so."""


def _nothing(time: int) -> Mapping[str, Any]:
    """Raise LookupError: the source has no blocks but those that it names."""
    raise LookupError(time)


async def _send_news(socket: WebSocket, source: PageSource) -> None:
    """Send what is new until the page goes away."""
    async with _until_gone(socket) as gone:
        known: Any = None
        time, sent = asyncio.get_running_loop().time, 0.0
        while not gone.is_set():
            known, news = await asyncio.to_thread(source.news, known)
            if not news and time() - sent >= BEAT:
                news = [{"type": "beat"}]
            for one in news:
                await socket.send_text(json_bytes(one).decode())
                sent = time()
            with suppress(TimeoutError):
                await asyncio.wait_for(gone.wait(), POLL)


@asynccontextmanager
async def _until_gone(socket: WebSocket) -> AsyncIterator[asyncio.Event]:
    gone = asyncio.Event()

    async def listen() -> None:
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass
        gone.set()

    task = asyncio.ensure_future(listen())
    try:
        yield gone
    finally:
        task.cancel()
