"""A team live in Foxglove: what a recording would have, served over its websocket protocol (foxglove-sdk).

Who subscribes to a topic gets its last message at once, as of a latched topic of ROS 2: the ground of a world is
published once. Events are told as they happen, and not again.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fame.closing import Closing
from fame.errors import ConfigError
from fame.imports import require
from fame.log.channels import CHANNELS, EVENTS
from fame.log.recording_file import ChannelSink


class FoxgloveServer(Closing):
    """Serves channels at a `port` (0: any free one) of an address, encrypted with `tls` (certificate and key in PEM).

    Raises UnavailableError without foxglove-sdk, and ConfigError for an address that cannot be opened.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0, tls: tuple[Path, Path] | None = None) -> None:
        require("foxglove")
        import foxglove
        import foxglove.websocket

        # it would print whatever a client sends wrongly, as a whole
        logging.getLogger("foxglove.websocket.connected_client").setLevel(logging.CRITICAL)
        listener = {"on_subscribe": staticmethod(self._on_subscribe)}
        self._foxglove, self._context = foxglove, foxglove.Context()
        self._schemas: list[Any] = []
        self._channels: list[Any] = [None]  # from 1 on, as in a file
        self._numbers: dict[tuple[str, int], int] = {}
        self._last: dict[int, tuple[Any, bytes, int]] = {}  # by the SDK's id of a channel: what was logged last
        self.sink: ChannelSink = ChannelSink(self)
        for topic in CHANNELS:  # the SDK advertises a new one to clients a moment before it takes subscriptions to it
            self.sink.open(topic)
        try:
            cert, key = (path.read_bytes() for path in tls) if tls is not None else (None, None)
            self._server: Any = foxglove.start_server(
                name="fame", host=host, port=port, context=self._context, tls_cert=cert, tls_key=key,
                server_listener=type("Listener", (foxglove.websocket.ServerListener,), listener)(),
            )  # fmt: skip
        except (OSError, RuntimeError, ValueError, OverflowError) as error:
            raise ConfigError(f"Foxglove cannot be served at {host}:{port}: {error}") from None
        shown = f"[{host}]" if ":" in host else host
        self.address: str = f"{'ws' if tls is None else 'wss'}://{shown}:{self._server.port}"

    def close(self) -> None:
        """Disconnect all clients."""
        self._server.stop()

    def _on_subscribe(self, client: Any, channel: Any) -> None:
        """Give a new subscriber what was published last, in a thread of the SDK."""
        if (last := self._last.get(channel.id)) is not None:
            home, data, time = last
            home.log(data, log_time=time)

    # ---- what a sink writes to ---------------------------------------------------------------------------------------

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        self._schemas.append(self._foxglove.Schema(name=name, encoding=encoding, data=data))
        return len(self._schemas) - 1

    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Return the channel of a topic: one for all its publishers."""
        number = self._numbers.setdefault((topic, schema), len(self._channels))
        if number == len(self._channels):
            given = {"schema": self._schemas[schema], "message_encoding": encoding, "context": self._context}
            self._channels.append(self._foxglove.Channel(topic, **given))
        return number

    def message(self, channel: int, time: int, data: bytes) -> None:
        home = self._channels[channel]
        if home.topic() != EVENTS:
            self._last[home.id()] = home, data, time
        home.log(data, log_time=time)

    def metadata(self, name: str, data: Mapping[str, str]) -> None: ...
    def attachment(self, name: str, media_type: str, data: bytes) -> None: ...
    def flush(self) -> None: ...
    def finish(self) -> None: ...
