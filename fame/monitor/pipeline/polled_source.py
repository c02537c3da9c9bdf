"""Machine: a processor without inputs that polls a machine outside ROS.

A source is a callable (``module:function``, ``file.py:function``), a TCP server that sends lines (``tcp://host:port``),
or a serial line (``serial:///dev/ttyUSB0?baud=115200``). A callable gives a number, several, a mapping by name, or None
for nothing new. A line is numbers apart by spaces, commas or semicolons, or ``name=value`` pairs; its last whole one at
the time of the call counts. Nothing here blocks: the node continues while a machine is silent or unreachable.
"""

from __future__ import annotations

import errno
import os
import re
import select
import socket
import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import parse_qs, urlsplit

from fame.errors import ConfigError
from fame.monitor.pipeline.processor import Parameter, Processor, Result, Samples
from fame.monitor.pipeline.stand_in import look_up

_RETRY_CALLS = 50  # calls between two attempts to reach a machine that is away
_MAX_LINE = 1 << 16  # bytes of a line, at most


class Machine(Processor):
    """The values of `fields`, each an output of that name. Raises ConfigError for a source of another form."""

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("source", "str", "", description="module:function, tcp://host:port or serial:///dev/...", fixed=True),
        Parameter("fields", "strs", ("value",), description="names of the numbers on a line, in order", fixed=True),
    )
    source: str
    fields: tuple[str, ...]

    def __init__(self, source: str | Callable[[], Any] = "", folder: str | Path = ".", **values: Any) -> None:
        super().__init__(**values)
        self.source = source if isinstance(source, str) else getattr(source, "__name__", "callable")
        self.outputs: tuple[str, ...] = self.fields
        self._poll = source if callable(source) else _callable(source, Path(folder))
        self._open = None if self._poll is not None else _opener(self.source)
        self._connection: _TcpConnection | _SerialConnection | None = None
        self._rest, self._wait = b"", 0

    @classmethod
    def as_known(cls, source: str = "", folder: str | Path = ".", **values: Any) -> Machine:
        """Return one whose callable is looked up, but not imported. Raises ConfigError."""
        return cls(source if "://" in source else look_up(source, Path(folder)), **values)

    def execute(self, inputs: Mapping[str, Samples], /) -> Result:
        answer = self._poll() if self._poll is not None else self._last_line()
        return None if answer is None else self._by_name(answer)

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _by_name(self, answer: Any) -> Result:
        """Return values by name. An answer that lacks one, or holds other than numbers, is reported and left out."""
        given = answer if isinstance(answer, Mapping) else None
        if given is None:
            items = list(answer) if isinstance(answer, Sequence) or hasattr(answer, "__len__") else [answer]
            given = dict(zip(self.fields, items, strict=False))
        try:
            return {name: float(given[name]) for name in self.fields}
        except (KeyError, TypeError, ValueError) as error:
            self.report(f"{self.source}: left out: {str(answer)[:60]!r} ({type(error).__name__}: {error})")
            return None

    def _last_line(self) -> Any:
        """Return the last whole line that has arrived, parsed; None without one."""
        assert self._open is not None
        if self._wait:
            self._wait -= 1
            return None
        try:
            self._connection = self._connection or self._open()
            data = self._rest + self._connection.read()
        except OSError as error:
            self.close()
            self._rest, self._wait = b"", _RETRY_CALLS
            self.report(f"{self.source}: away: {error.strerror or error}")
            return None
        whole, _, self._rest = data.rpartition(b"\n")
        self._rest = self._rest[-_MAX_LINE:]
        lines = [line.strip() for line in whole.splitlines() if line.strip()]
        return parse_line(lines[-1].decode("utf-8", "replace")) if lines else None


def parse_line(text: str) -> list[str] | dict[str, str]:
    """Return the tokens of a line, by name if it has names."""
    tokens = [token for token in re.split(r"[\s,;]+", text) if token]
    if tokens and all("=" in token for token in tokens):
        return dict(token.split("=", 1) for token in tokens)
    return tokens


class _TcpConnection:
    """A TCP connection, established or in progress. As those below, `read` gives what has arrived since its last call,
    or b"", and raises OSError if the machine is unreachable."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket()
        self._socket.setblocking(False)
        self._connected = False
        code = self._socket.connect_ex((host, port))
        if code not in (0, errno.EINPROGRESS):
            self.close()
            raise OSError(code, os.strerror(code))

    def read(self) -> bytes:
        if not self._connected:
            if not select.select([], [self._socket], [], 0)[1]:
                return b""
            code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if code:
                raise OSError(code, os.strerror(code))
            self._connected = True
        return _drain(lambda: self._socket.recv(4096))

    def close(self) -> None:
        self._socket.close()


class _SerialConnection:
    """A terminal in raw mode."""

    def __init__(self, path: str, baud: int) -> None:
        import termios
        import tty

        self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        try:
            if not stat.S_ISCHR(os.fstat(self._file).st_mode):
                raise OSError(errno.ENOTTY, "is not a serial line")
            tty.setraw(self._file)
            settings = termios.tcgetattr(self._file)
            settings[4] = settings[5] = getattr(termios, f"B{baud}")
            termios.tcsetattr(self._file, termios.TCSANOW, settings)
        except (OSError, termios.error) as error:
            os.close(self._file)
            raise OSError(*error.args[:2]) from None

    def read(self) -> bytes:
        return _drain(lambda: os.read(self._file, 4096))

    def close(self) -> None:
        os.close(self._file)


def _drain(receive: Callable[[], bytes]) -> bytes:
    """Receive all that is there. Raises OSError at the end of the stream."""
    parts: list[bytes] = []
    try:
        while part := receive():
            parts.append(part)
    except BlockingIOError:
        return b"".join(parts)
    if parts:
        return b"".join(parts)
    raise OSError(errno.ECONNRESET, "the other side has closed")


def _callable(source: str, folder: Path) -> Callable[[], Any] | None:
    """Return the function of ``module:function``; None for an address. Raises ConfigError."""
    if "://" in source:
        return None
    from fame.config.loader import find_object

    found = find_object(source, folder)
    if not callable(found):
        raise ConfigError(f"expected a callable, got {source!r}", element="source")
    made: Callable[[], Any] = found
    return made


def _opener(source: str) -> Callable[[], _TcpConnection | _SerialConnection]:
    """What opens an address. Raises ConfigError."""
    import termios

    try:
        parts = urlsplit(source)
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            host, port = parts.hostname, parts.port
            return lambda: _TcpConnection(host, port)
        baud = int(parse_qs(parts.query).get("baud", ["115200"])[0])
        if parts.scheme == "serial" and parts.path and hasattr(termios, f"B{baud}"):
            path = parts.path
            return lambda: _SerialConnection(path, baud)
    except ValueError:
        pass
    text = f"expected tcp://host:port, serial:///dev/ttyUSB0?baud=115200 or module:function, got {source!r}"
    raise ConfigError(text, element="source")
