"""``fame log collect``: fetch the recordings that engines keep, as far as they are not here yet."""

from __future__ import annotations

import sys
import time
from argparse import ArgumentTypeError, Namespace
from base64 import b64decode
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, Parser, add_json, add_key, command, positive, private_key
from fame.cli.network import add_network, connected, wait_until
from fame.cli.output import note, print_json, progress_line, table
from fame.errors import ConfigError, DeploymentError
from fame.text import printable, read_json

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Node

_AGAIN, _PATIENCE = 1.0, 10.0
"""After how long a request is repeated, and after how long a robot is given up (s)."""
_LONGEST = 1_000_000
_OVERLAP = 4096
"""Bytes at the end of the local file that are compared: it may be another file, or damaged by a loss of power."""


def add(parts: Commands) -> None:
    parser: Parser = command(
        parts, "collect", collect,
        examples=("fame log collect -o recordings", "fame log collect -o recordings --since PT2H --robot REX"),
        help="fetch the recordings that engines keep (fame engine --log); what is here already is not fetched again; "
        "exit code 1 if something is missing",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="DIR", help="folder with a folder for each robot"
    )
    parser.add_argument("--robot", action="append", default=[], metavar="NAME", help="of this robot only; repeatable")
    parser.add_argument(
        "--since", type=moment, default=0.0, metavar="DATE",
        help="only what was written since a date, or a duration ago (2026-11-29T08:00, PT2H)",
    )  # fmt: skip
    parser.add_argument(
        "--limit", type=positive, default=1000.0, metavar="MB", help="fetch so much at most, the newest first (1000 MB)"
    )
    add_key(parser, "sign the requests with this key")
    add_network(parser)
    add_json(parser)


def moment(text: str) -> float:
    """Return a date, or the date a duration ago (s since 1970)."""
    from fame.errors import FameError
    from fame.iso8601 import add as later, parse_datetime, parse_duration

    now = datetime.now(UTC)
    try:
        if text[:1] in "pP":
            ahead = later(now, parse_duration(text)).timestamp() - now.timestamp()
            return now.timestamp() - ahead
        return parse_datetime(text).timestamp()
    except (FameError, ValueError):
        raise ArgumentTypeError(f"expected a date or a duration, as 2026-11-29T08:00 or PT2H, got {text!r}") from None


def collect(arguments: Namespace) -> int:
    """Fetch what each robot has, and say what is missing."""
    from fame.cli.robots import subscribe_reports
    from fame.clock import SECOND
    from fame.deploy import engines
    from fame.fleet.log_server import LOG_TOPIC

    if arguments.output.exists() and not arguments.output.is_dir():
        raise ConfigError("expected a folder, got a file", file=str(arguments.output))
    key = private_key(arguments)
    with connected(arguments) as (scheduler, middleware):
        scheduler.run(scheduler.now + SECOND)
        wanted = set(arguments.robot)
        if not wanted <= set(engines(middleware)):
            note(f"looking for {', '.join(sorted(wanted - set(engines(middleware))))}, up to {_PATIENCE:g} s")
            wait_until(scheduler, lambda: wanted <= set(engines(middleware)), _PATIENCE)
        robots = sorted(wanted or engines(middleware))
        if not robots:
            raise DeploymentError("no engine was found")
        there = set(engines(middleware))
        served = {info.name for info in middleware.graph() if info.publishers}
        node = middleware.node("_fame_collect")
        reports, *_ = subscribe_reports(node, robots, [key.public_key()] if key is not None else [])
        if key is not None:  # requests are signed for the run of an engine
            wait_until(scheduler, lambda: reports.keys() >= set(robots), _PATIENCE)
        remaining = round(arguments.limit * 1e6)
        told: dict[str, Any] = {}
        for robot in robots:
            born = reports[robot].born if robot in reports else 0
            if f"/{robot}/{LOG_TOPIC}" not in served:
                why = "its engine keeps no recordings (--log), or has an older FAME"
                text = why if robot in there else f"no engine of this name was found within {_PATIENCE:g} s"
                told[robot] = {"files": [], "fetched": 0, "missing": [text]}
                continue
            source = _Source(robot, node, scheduler, key, born)
            told[robot], remaining = _fetch_all(source, arguments, remaining)
    missing = any(found["missing"] for found in told.values())
    if arguments.json:
        print_json({"status": "failed" if missing else "completed", "robots": told})
    else:
        rows = [(robot, str(len(found["files"])), _megabytes(found["fetched"])) for robot, found in told.items()]
        print(table(("robot", "recordings", "fetched"), rows))
        for robot, found in told.items():
            print(*(f"{robot}: missing: {text}\n" for text in found["missing"]), sep="", end="")
    return int(missing)


def _fetch_all(source: _Source, arguments: Namespace, remaining: int) -> tuple[dict[str, Any], int]:
    """Fetch the recordings of a robot, the newest first. Returns what is told of it, and the bytes that may follow."""
    from fame.fleet.engine_log import FILES

    files: list[str] = []
    missing: list[str] = []
    fetched = 0
    try:
        listed = source.files()
        if not listed:
            missing.append("it keeps no recordings")
        elif min(found[2] for found in listed) > arguments.since > 0 and len(listed) >= FILES:
            oldest = datetime.fromtimestamp(min(found[2] for found in listed), UTC).isoformat(timespec="seconds")
            missing.append(f"what was written before {oldest} may have been deleted: an engine keeps its last files")
        for name, size, _ in reversed([found for found in listed if found[2] >= arguments.since]):
            path = arguments.output / source.robot / name
            here = path.stat().st_size if path.exists() else 0
            if path.is_dir():
                missing.append(f"{name}: {path} is a folder: rename it")
            elif here > size:
                missing.append(f"{name}: {path} has {here} bytes, the robot's {size}: it is another file")
            elif size - here > remaining:
                missing.append(f"{name}: {_megabytes(size - here)} are above --limit")
            else:
                got = source.fetch(name, path, size)
                fetched, remaining = fetched + got, remaining - got
                files.append(name)
    except DeploymentError as error:
        missing.append(str(error))
    return {"files": sorted(files), "fetched": fetched, "missing": missing}, remaining


class _Source:
    """The recordings of one robot."""

    def __init__(self, robot: str, node: Node, scheduler: WallScheduler, key: Any, born: int) -> None:
        from fame.deploy.envelope import STRING
        from fame.fleet.log_server import LOG_TOPIC

        self.robot = robot
        self._scheduler, self._key, self._born = scheduler, key, born
        self._numbers = (f"{time.time_ns():x}-{number}" for number in count())
        self._answers: dict[str, Mapping[str, Any]] = {}
        self._out = node.publisher(f"/{robot}/{LOG_TOPIC}", STRING)
        node.subscription(f"/{robot}/{LOG_TOPIC}", STRING, self._on_answer)

    def files(self) -> list[tuple[str, int, float]]:
        """Return name, size (bytes) and time of the last write (s since 1970) of each. Raises DeploymentError."""
        try:
            return [(_name(name), int(size), float(at)) for name, size, at in self._ask()["files"]]
        except (ValueError, TypeError, KeyError):
            raise DeploymentError("its answer cannot be read") from None

    def fetch(self, name: str, path: Path, size: int) -> int:
        """Append to a file what it lacks of `size` bytes. Returns how many were fetched. Raises DeploymentError."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "a+b") as file, progress_line(sys.stderr) as line:
            begin = file.tell()
            offset = file.seek(max(0, begin - _OVERLAP))
            here = file.read()
            while offset < size:
                answer = self._ask(file=name, offset=offset)
                try:
                    data = b64decode(str(answer["data"]), validate=True)[: size - offset]
                except (ValueError, KeyError):
                    raise DeploymentError(f"{name}: its answer cannot be read") from None
                if not data:
                    raise DeploymentError(f"{name}: it has become shorter; {offset} of {size} bytes are here")
                if not data.startswith(here[: len(data)]):
                    raise DeploymentError(f"{name}: {path} does not end as the robot's file did: remove it")
                file.write(data[len(here) :])
                offset, here = offset + len(data), here[len(data) :]
                if line is not None:
                    line.write(f"{self.robot} {printable(name)}: {offset / size:.0%}", offset / size)
        return offset - begin

    def _ask(self, **what: Any) -> Mapping[str, Any]:
        """Ask until the robot answers. Raises DeploymentError."""
        from fame.deploy.envelope import STRING
        from fame.fleet.log_server import LogRequest
        from fame.middleware import messages

        request = LogRequest(id=next(self._numbers), **what)
        until = self._scheduler.now + round(_PATIENCE * 1e9)
        while self._scheduler.now < until:
            sent = request
            if self._key is not None:
                sent = request.signed(self.robot, self._key, born=self._born, now=time.time())
            self._out.publish(messages.create(STRING, sent.to_json()))
            if wait_until(self._scheduler, partial(self._answers.__contains__, request.id), _AGAIN):
                answer = self._answers.pop(request.id)
                if "error" in answer:
                    raise DeploymentError(printable(str(answer["error"])))
                return answer
        raise DeploymentError(f"did not answer within {_PATIENCE:g} s")

    def _on_answer(self, message: Any) -> None:
        try:
            answer = read_json(message.data, _LONGEST)
            self._answers[str(answer["answer"])] = answer
        except (ValueError, TypeError, KeyError):
            return  # a question, or from a stranger


def _megabytes(size: int) -> str:
    """A size (bytes) with two digits that count, since a recording of a short mission has some kilobytes."""
    return f"{size / 1e6:.1f} MB" if size >= 1e6 or not size else f"{size / 1e6:.2g} MB"


def _name(name: Any) -> str:
    """The name of a file without a folder. Raises ValueError."""
    if not isinstance(name, str) or Path(name).name != name or name in ("", ".", ".."):
        raise ValueError(name)
    return name
