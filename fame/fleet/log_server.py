"""The recordings of an engine for others: questions and answers on ``/<robot>/bpmn_log``, as JSON.

A `LogRequest` without a file asks for the list of recordings, one with a file for a part of it. Where keys are used
requests are signed, as those of people are (`fame.deploy.requests`).
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fame.dataclasses import dataclass
from fame.deploy import fields
from fame.deploy.envelope import STRING
from fame.deploy.requests import SignedRequest
from fame.errors import DeploymentError
from fame.fast_json import json_bytes
from fame.middleware import messages
from fame.middleware.interface import Node
from fame.text import read_json

LOG_TOPIC = "bpmn_log"
PART = 150_000
"""How many bytes of a file an answer has at most."""
_LONGEST = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRequest(SignedRequest):
    """Ask for the list of recordings, or for the bytes of a `file` from `offset` on."""

    file: fields.Name = ""
    offset: fields.Count = 0


class LogServer:
    """The engine's end: answers for the recordings of a robot in a folder.

    `verify` raises DeploymentError for a request that is not from somebody who is trusted.
    """

    def __init__(self, node: Node, robot: str, folder: Path, verify: Callable[[LogRequest], object]) -> None:
        self._robot, self._folder, self._verify = robot, folder, verify
        self._out = node.publisher(LOG_TOPIC, STRING)
        node.subscription(LOG_TOPIC, STRING, self._on_request)

    def _on_request(self, message: Any) -> None:
        try:
            found = read_json(message.data, _LONGEST)
        except ValueError:
            return  # from a stranger
        if not isinstance(found, dict) or "answer" in found:
            return
        try:
            request = fields.read(LogRequest, found)
        except TypeError as error:  # of another release: its sender is told
            self._answer(found.get("id"), {"error": f"this FAME does not know what is asked: {error}"})
            return
        try:
            self._verify(request)
            answer = self._part(request) if request.file else self._list()
        except DeploymentError as error:
            answer = {"error": str(error)}
        except OSError as error:
            answer = {"error": f"{request.file or self._folder}: {error.strerror}"}
        self._answer(request.id, answer)

    def _answer(self, id: Any, answer: Mapping[str, Any]) -> None:
        if isinstance(id, str):
            self._out.publish(messages.create(STRING, json_bytes({**answer, "answer": id}).decode()))

    def _files(self) -> list[Path]:
        return sorted(self._folder.glob(f"{self._robot}-*.mcap"), key=lambda path: path.stat().st_mtime)

    def _list(self) -> dict[str, Any]:
        """The recordings, oldest first: name, size (bytes), and when each was written last (s since 1970)."""
        stats = ((path.name, path.stat()) for path in self._files())
        return {"files": [[name, stat.st_size, stat.st_mtime] for name, stat in stats]}

    def _part(self, request: LogRequest) -> dict[str, Any]:
        if request.file not in {path.name for path in self._files()}:
            raise DeploymentError(f"{request.file}: there is no such recording any more", cause="file")
        with open(self._folder / request.file, "rb") as file:
            file.seek(request.offset)
            return {"from": request.offset, "data": b64encode(file.read(PART)).decode()}
