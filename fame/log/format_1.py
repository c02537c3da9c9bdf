"""Reads recordings of format 1 (FAME 0.2): writes them anew, as they would be recorded today.

They do not say what a scope is. Here it is guessed: a scope is inside the activity whose token entered it last, as far
as the models tell; of what was going on when the recording began, or when batches were lost, from the path of the
tokens that waited. To be removed with the release after 0.3.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import count
from pathlib import PurePath
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, BinaryIO

from fame.bpmn.model import CallActivity
from fame.bpmn.reader import read
from fame.errors import ModelError
from fame.log.channels import EVENTS, KEY, VARIABLES, WAITING
from fame.log.recording_file import RecordingFile
from fame.log.team_state import KeyWriter
from fame.robot.robot_state import RobotState

if TYPE_CHECKING:
    from fame.log.recording import Recording

_GUESSED = 1 << 40
"""The number of the first scope of which only the path is known."""


def renew(recording: Recording) -> BinaryIO:
    """Return a file with the content of a recording of format 1 in the present format. To be closed."""
    stream: Any = TemporaryFile()  # noqa: SIM115 (who gets it closes it)
    try:
        _write(recording, RecordingFile(stream))
    except BaseException:
        stream.close()
        raise
    stream.seek(0)
    found: BinaryIO = stream
    return found


def _write(recording: Recording, file: RecordingFile) -> None:
    file.describe({name: text for name, text in recording.metadata.items() if name != "format"})
    for name, data in recording.attachments.items():
        file.attach(name, "application/octet-stream", data)
    renewal, channels = _Renewal(recording, KeyWriter(file.put)), dict[tuple[str, str], int]()
    for message in recording.messages():
        place = message.topic, message.node
        if message.topic in (EVENTS, VARIABLES, WAITING, KEY):
            renewal.take(message.time, message.topic, message.json())
        elif message.topic.startswith("/fame/"):
            file.put(message.topic, message.time, message.json())
        else:
            if place not in channels:
                channels[place] = file.same_channel(*recording.channel(*place))
            file.write(channels[place], message.time, message.data)
    renewal.close_scopes()
    file.finish()


class _Models:
    """Where elements are: id -> number of a model and the body that it is in (id); and the calls of processes."""

    def __init__(self, sources: Iterable[tuple[str, bytes]]) -> None:
        self.places: dict[str, list[tuple[int, str]]] = {}
        self.called: dict[str, str] = {}
        self.containers: set[str] = set()
        self.handlers: set[str] = set()
        stems: dict[str, str] = {}
        for number, (name, source) in enumerate(sources):
            with suppress(ModelError):
                processes = read(source, file=name).processes
                if len(processes) == 1:
                    stems[PurePath(name).stem] = processes[0].id
                for process in processes:
                    self._add(process.id, number, "")
                    bodies = [(process.id, process.body)]
                    for owner, body in bodies:
                        for part in (*body.nodes, *body.flows):
                            self._add(part.id, number, owner)
                        for node in body.nodes:
                            if isinstance(node, CallActivity):
                                self.called[node.id] = node.called
                            if node.body is not None:
                                bodies.append((node.id, node.body))
                                self.handlers |= {node.id} if node.triggered_by_event else set()
                            if isinstance(node, CallActivity) or node.body is not None:
                                self.containers.add(node.id)
        for id, called in self.called.items():
            self.called[id] = called if called in self.places else stems.get(called, "")

    def _add(self, id: str, file: int, owner: str) -> None:
        self.places.setdefault(id, []).append((file, owner))

    def containers_of(self, path: Sequence[str]) -> tuple[str, ...]:
        """Return a path without a task at its end, which is repeated or has variables of its own."""
        return tuple(path if not path or path[-1] not in self.places or path[-1] in self.containers else path[:-1])

    def body(self, state: RobotState, scope: int) -> str:
        """Return the process or sub-process (id) whose elements are in a scope."""
        for known in state.around(scope):
            if known.inside:
                return self.called.get(known.inside[-1], known.inside[-1])
        return state.instances.get(state.scopes[scope].instance, ("", ""))[0]

    def file(self, id: str) -> int:
        """Return the number of the model of an element, or of the process that it calls."""
        return self.places.get(self.called.get(id, id), [(0, "")])[0][0]


class _Renewal:
    """Passes messages on to a writer as today's, after what was guessed of their scopes."""

    def __init__(self, recording: Recording, writer: KeyWriter) -> None:
        self._sources, self._runs, self._writer = recording.models, recording.runs, writer
        self._models: dict[tuple[str, ...], _Models] = {}
        self._same: dict[tuple[str, int], int] = {}  # robot, scope -> the number under which it was guessed before
        self._numbers = count(_GUESSED)
        self._ending: dict[tuple[str, int], None] = {}  # scopes whose activity has been left at this instant
        self._begun = False

    def take(self, time: int, topic: str, data: Mapping[str, Any]) -> None:
        """Pass on a message."""
        if time > self._writer.last:
            self.close_scopes()
        if topic == KEY:
            self._take_key(time, data)
            return
        robot = data["robot"]
        state = self._writer.state.robots.setdefault(robot, RobotState())
        if topic == EVENTS:
            for group in data["events"]:
                self._take_events(time, robot, state, group)
        elif topic == VARIABLES:
            for change in data["changes"]:
                place = self._place_by_path(time, robot, state, change)
                kept = {name: change[name] for name in ("set", "unset", "gone") if name in change}
                self._writer.change(time, VARIABLES, {"robot": robot, "changes": [{"scope": place, **kept}]})
                if "gone" in change:
                    self._ending.pop((robot, place), None)
        else:
            tokens = [self._token(time, robot, state, token) for token in data["tokens"]]
            self._writer.change(time, WAITING, {"robot": robot, "tokens": tokens, "gone": data["gone"]})

    def close_scopes(self) -> None:
        """End the scopes whose activity was left."""
        ending, self._ending = self._ending, {}
        for robot, scope in ending:
            if scope in self._writer.state.robots[robot].scopes:
                self._writer.change(self._writer.last, VARIABLES, _ends(robot, scope))

    # ---- events ------------------------------------------------------------------------------------------------------

    def _take_events(self, time: int, robot: str, state: RobotState, group: Mapping[str, Any]) -> None:
        instance, scope, marks = group["instance"], group["scope"], group["marks"]
        if scope and marks and self._known(robot, scope) not in state.scopes:
            self._guess(time, robot, state, instance, scope, marks)
        scope = self._known(robot, scope)
        events = [{"instance": instance, "scope": scope, "marks": marks}]
        self._writer.change(time, EVENTS, {"robot": robot, "events": events})
        for element, what in (mark[:2] for mark in marks):
            if what == "end":
                ended = [key for key, known in state.scopes.items() if known.instance == instance]
            elif what in ("leave", "cancel", "fail") and (scope, element) not in state.active:
                ended = [
                    key
                    for key, known in state.scopes.items()
                    if known.inside[-1:] == (element,) and scope in (key, known.parent)
                ]
            else:
                continue
            self._ending.update(dict.fromkeys((robot, key) for key in ended))

    def _known(self, robot: str, scope: int) -> int:
        return self._same.get((robot, scope), scope)

    def _guess(
        self, time: int, robot: str, state: RobotState, instance: int, scope: int, marks: Sequence[Sequence[Any]]
    ) -> None:
        """Open a scope, as its first event tells, unless what it leaves was entered in one that was guessed before."""
        models, (element, what) = self._models_of(robot, time), marks[0][:2]
        here = [key for key, known in state.scopes.items() if known.instance == instance]
        left = [mark[0] for mark in marks if mark[1] in ("leave", "cancel", "fail")]
        guessed = (key for key in here if key >= _GUESSED and any((key, id) in state.active for id in left))
        if (same := next(guessed, None)) is not None:
            self._same[robot, scope] = same
            return
        for where, opener in [*state.active][::-1] if what not in ("start", "end") else ():
            for file, owner in models.places.get(element, ()):
                if where in here and owner and owner == models.called.get(opener, opener):
                    self._open(time, robot, instance, scope, where, [opener], file)
                    return
        for file, owner in models.places.get(element, ()):
            handler = next((each for each in (element, owner) if each in models.handlers), "")
            bodies = [body for place, body in models.places.get(handler, ()) if place == file]
            around = [key for key in here if models.body(state, key) in bodies]
            if around:
                self._open(time, robot, instance, scope, around[-1], [handler], file)
                return
        self._open(time, robot, instance, scope, here[0] if here else 0, [], models.file(element))

    def _open(
        self, time: int, robot: str, instance: int, scope: int, parent: int, inside: Sequence[str], file: int
    ) -> None:
        opened = {"scope": scope, "instance": instance, "parent": parent, "inside": inside, "file": file}
        self._writer.change(time, EVENTS, {"robot": robot, "opens": [opened], "events": []})

    # ---- paths -------------------------------------------------------------------------------------------------------

    def _token(self, time: int, robot: str, state: RobotState, token: Mapping[str, Any]) -> dict[str, Any]:
        scope = self._place_by_path(time, robot, state, token)
        return {name: each for name, each in token.items() if name not in ("path", "body", "sees")} | {"scope": scope}

    def _place_by_path(self, time: int, robot: str, state: RobotState, entry: Mapping[str, Any]) -> int:
        """The scope of a token or of variables, which is opened if it is new."""
        scope, models = self._known(robot, entry["scope"]), self._models_of(robot, time)
        if scope not in state.scopes:
            path = models.containers_of(entry["path"])
            around, inside = _nearest(state, entry["instance"], path)
            file = models.file(path[-1]) if path else models.file(state.process)
            self._open(time, robot, entry["instance"], scope, around, inside, file)
        return scope

    def _take_key(self, time: int, data: Mapping[str, Any]) -> None:
        """Take the state of robots of which it is not known otherwise."""
        fresh = data.get("gaps", {}) if self._begun else data["robots"]
        if fresh:
            self._writer.state.robots.update(
                (robot, self._state(time, robot, data["robots"][robot])) for robot in fresh
            )
            self._writer.key(time, data.get("gaps"))
        self._begun = True

    def _state(self, time: int, robot: str, key: Mapping[str, Any]) -> RobotState:
        models, state = self._models_of(robot, time), RobotState(key["process"])
        state.instances = {each["instance"]: (each["process"], each["status"]) for each in key["instances"]}
        over = Counter(status for _, status in state.instances.values() if status != "running")
        state.ended = dict(key.get("ended", over))
        for each in sorted(key["variables"], key=lambda each: len(each["path"])):
            self._enter(state, models, each, time)
            state.apply(VARIABLES, {"changes": [each]}, time)
        for token in key["tokens"]:
            scope = self._enter(state, models, token, token["since"])
            shown = {name: each for name, each in token.items() if name not in ("path", "body", "sees")}
            state.tokens[token["key"]] = shown
            state.active.setdefault((scope, token["element"]), [0, token["since"]])[0] += 1
        for id, marks in key["counts"].items():
            state.counts.setdefault(models.places.get(id, [(0, "")])[0][0], {})[id] = {**marks}
        return state

    def _enter(self, state: RobotState, models: _Models, entry: Mapping[str, Any], since: int) -> int:
        """Open the scope of a token or of variables, and those around it with their tokens on activities."""
        scope, instance, whole = int(entry["scope"]), entry["instance"], entry["path"]
        if scope in state.scopes:
            return scope
        path = models.containers_of(whole)
        around, left = _nearest(state, instance, path)
        if not around and path:
            around = next(self._numbers)
            self._open_in(state, models, around, instance, ())
        for depth in range(len(path) - len(left), len(path)):
            inner = scope if depth == len(whole) - 1 else next(self._numbers)
            self._open_in(state, models, inner, instance, path[: depth + 1])
            place = inner if path[depth] in models.handlers else around
            state.active.setdefault((place, path[depth]), [0, since])[0] += 1
            around = inner
        if scope not in state.scopes:  # one more with that path, as of one of several instances
            self._open_in(state, models, scope, instance, path)
        return scope

    def _open_in(self, state: RobotState, models: _Models, scope: int, instance: int, path: Sequence[str]) -> None:
        parent, inside = _nearest(state, instance, tuple(path))
        file = models.file(path[-1]) if path else models.file(state.process)
        state.open_scope({"scope": scope, "instance": instance, "parent": parent, "inside": inside, "file": file})

    def _models_of(self, robot: str, time: int) -> _Models:
        """The models that a robot ran at a time."""
        runs = [run.models for run in self._runs.get(robot, ()) if run.time < time]
        names = tuple(runs[-1] if runs else self._sources)
        if names not in self._models:
            self._models[names] = _Models((name, self._sources.get(name, b"")) for name in names)
        return self._models[names]


def _nearest(state: RobotState, instance: int, path: tuple[str, ...]) -> tuple[int, Sequence[str]]:
    """The innermost scope of an instance around a path, 0 without one; and what of the path leads on from there."""
    scopes = ((len(state.path(key)), key) for key, known in state.scopes.items() if known.instance == instance)
    fitting = [(length, key) for length, key in scopes if state.path(key) == path[:length]]
    length, nearest = max(fitting, default=(0, 0))
    return nearest, path[length:]


def _ends(robot: str, scope: int) -> Mapping[str, Any]:
    return {"robot": robot, "changes": [{"scope": scope, "gone": True}]}
