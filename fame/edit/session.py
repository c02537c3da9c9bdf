"""The source of the page that edits a model: it gives the text, checks what is drawn, and writes it.

The page has the text of the file at one time (`hash`), and says once what its editor writes of it unchanged: its base,
which is kept here together with the hash if it says what the file says. What is drawn is written into that text
(`fame.edit.writer`), and only while the file still has it: else the page is given what has changed in the file, by
element, and decides.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from fame.bpmn.difference import ORDER, ElementChange
from fame.bpmn.model import Definitions
from fame.bpmn.reader import read_bytes, read_text
from fame.bpmn.reader.xml import CAMUNDA, ZEEBE, parse, read_file
from fame.bpmn.tags import decoded
from fame.check import Finding, check
from fame.check.element_templates import message_types, of_camunda8, templates
from fame.check.library import behaviours
from fame.check.scope import of_error
from fame.config.loader import read_document
from fame.edit.changes import Root, compare, lines
from fame.edit.commits import committed
from fame.edit.completion import Completer, RobotTopics, robot_topics
from fame.edit.exploring import Explorer
from fame.edit.running import EditedRun
from fame.edit.writer import save_bytes
from fame.errors import ConfigError, FameError, ModelError
from fame.rooms import ADD_DIAGRAM, load
from fame.scenario.plan import ScenarioFile, known_to_check
from fame.scenario.scenario import world_topics
from fame.text import unreadable, write_file
from fame.view.change import ModelChange
from fame.view.watch import ModelWatch

_NEW = b"""<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:bpmndi="http://www.omg.org/spec/BPMN/20100524/DI" xmlns:dc="http://www.omg.org/spec/DD/20100524/DC"
    xmlns:di="http://www.omg.org/spec/DD/20100524/DI" xmlns:camunda="http://camunda.org/schema/1.0/bpmn"
    id="Definitions_1" targetNamespace="http://bpmn.io/schema/bpmn">
  <bpmn:process id="Process_1" isExecutable="true">
    <bpmn:startEvent id="StartEvent_1" />
  </bpmn:process>
  <bpmndi:BPMNDiagram id="BPMNDiagram_1">
    <bpmndi:BPMNPlane id="BPMNPlane_1" bpmnElement="Process_1">
      <bpmndi:BPMNShape id="StartEvent_1_di" bpmnElement="StartEvent_1">
        <dc:Bounds x="180" y="160" width="36" height="36" />
      </bpmndi:BPMNShape>
    </bpmndi:BPMNPlane>
  </bpmndi:BPMNDiagram>
</bpmn:definitions>
"""
_PLATFORM = "{http://camunda.org/schema/modeler/1.0}executionPlatform"


def model_of(path: Path) -> Path:
    """Return the model to edit: the file, or that of a scenario. Raises ConfigError."""
    if path.suffix.lower() not in (".yaml", ".yml"):
        return path
    model = read_document(path).mapping().get("model")
    if model is None:
        raise ConfigError("expected a scenario with a model", file=str(path))
    return path.parent / model.text()


class ModelEdit(ModelWatch):
    """The source of that page. A model that does not exist is begun with a start event, and written when it is saved.

    `subject` is a model or a scenario, `modeler` the folder of `fame.edit.modeler`, `library` adds folders with called
    processes; `types` are folders of message types, which are registered. Raises ConfigError for
    a model that cannot be read.
    """

    longest = 40_000_000
    """Bytes of a command: a text of a model, and that with JSON's marks."""
    windows = 32
    """Bases that are kept; of more the oldest are forgotten."""

    def __init__(self, subject: Path, modeler: Path, library: Sequence[Path] = (), types: Sequence[Path] = ()) -> None:
        self.model: Path = model_of(subject)
        self._modeler, self._types = modeler, tuple(types)
        self._lock = threading.Lock()
        self._bases = dict[str, _Base]()
        self._completers = dict[str, Completer]()
        self._robots: tuple[ScenarioFile | None, RobotTopics] = (None, {})
        self._last = _NEW  # what the file had when a page opened or saved it
        self._drawn = (b"", b"")  # what was shown last: the file, and that with a diagram
        if self.model.suffix.lower() not in (".bpmn", ".xml"):
            raise ConfigError(f"expected MODEL.bpmn or SCENARIO.yaml, got {str(self.model)!r}", file=str(subject))
        if not self.model.parent.is_dir():
            raise ConfigError("cannot be written: there is no such folder", file=str(self.model.parent))
        parse(self._content(), str(self.model))
        self._explorer = Explorer(subject, self.model, library, types)
        self.run: EditedRun = EditedRun(subject, library)
        self.change: ModelChange | None = None  # what a team would change, if there is one
        super().__init__(subject, library, wait=not self.model.exists())

    def close(self) -> None:
        """End the run, and stop watching and exploring."""
        self.run.close()
        self._explorer.close()
        super().close()

    def _content(self) -> bytes:
        """What is in the file, or was before it was removed: then a save writes it again."""
        try:
            return read_file(self.model) if self.model.exists() else self._last
        except OSError as error:
            raise ConfigError(unreadable(error), file=str(self.model)) from None

    def _shown(self, content: bytes) -> bytes:
        """What is drawn: the file, with a diagram of what it does not draw."""
        if self._drawn[0] != content:
            model, drawn = read_bytes(content, file=str(self.model)), content
            with suppress(FameError):  # without the room, or with nothing to draw: the page says that it has no diagram
                drawn = bytes(load(ADD_DIAGRAM)(model)) if _has_gaps(model) else content
            self._drawn = content, drawn
        return self._drawn[1]

    # ---- for the page ------------------------------------------------------------------------------------------------

    def file(self, path: str) -> bytes | None:
        """Return a file of the page or of bpmn-js, or None."""
        home, name = (self._modeler, path.removeprefix("modeler/")) if path.startswith("modeler/") else (_PAGE, path)
        found = home.joinpath(*name.split("/")) if ".." not in name.split("/") else None
        return found.read_bytes() if found is not None and found.is_file() else None

    def mission(self) -> Mapping[str, Any]:
        """Everything that the page needs first: the model, and templates for its elements."""
        content = self._content()
        cloud = _is_camunda8(content, str(self.model))
        return {
            "kind": "edit",
            "title": self.model.name,
            "text": decoded(self._shown(content), str(self.model))[0],
            "hash": _hash(content),
            "there": self.model.exists(),
            "modeler": "camunda-cloud" if cloud else "camunda-platform",
            "templates": [made for one in self._templates() for made in (of_camunda8(one) if cloud else [one])],
            "control": ["save", "check", "compare", "explore"],
            "team": self.change is not None,
            "robots": [],
        }

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        version = self._version
        return version, [] if known == version else [self._file_news()]

    def _file_news(self) -> Mapping[str, Any]:
        return {"type": "file", "hash": _hash(self._content()), "there": self.model.exists()}

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """``open``: say what the editor writes of the file. Then ``check`` what is drawn, ``explore`` it until the same
        `window` checks or explores again, ``complete`` what somebody types there, ``save`` it, if the file is as the
        page has it, or ``compare`` it with the file. Raises FameError.
        """
        acts: Mapping[str, _Act] = {
            "check": self._checked,
            "save": self._saved,
            "compare": self._compared,
            "commit": self._since_commit,
            "explore": self._explored,
        }
        act, new, base = acts.get(str(command.get("do"))), command.get("new"), command.get("base")
        if command.get("do") == "open" and isinstance(base, str):
            with self._lock:
                return self._opened(command, base)
        if command.get("do") == "complete":
            with self._lock:
                return self._completed(command)
        if act is None or not isinstance(new, str):
            raise FameError("expected open with a base, or another command with what is drawn")
        with self._lock:
            begun = self._bases.get(str(base))
            if begun is None:
                raise FameError("it is not known what was opened: load the page again")
            _keep(self._bases, str(base), begun, self.windows)
            content = self._content()
            shown = self._shown(content)
            written = save_bytes(shown, begun.text, new, file=str(self.model))
            found = act({**command, "hash": begun.hash}, content, content if written == shown else written)
        return found() if callable(found) else found

    def _opened(self, command: Mapping[str, Any], base: str) -> Mapping[str, Any]:
        """Keep what the editor writes of the file, if it says nothing else than the file."""
        content, file = self._content(), str(self.model)
        if command.get("hash") != _hash(content):
            raise FameError("the file has been changed by somebody else meanwhile")
        found = compare(read_bytes(self._shown(content), file=file), read_text(base, file=file))
        if wrong := [one for one in found.changes if _is_new(one)]:
            text = f"the library reads {wrong[0].element.display_name} in another way than the file says it"
            raise FameError(f"{text}: nothing could be saved")
        self._last = content
        return {"base": self._kept(base, _hash(content))}

    def _kept(self, base: str, hash: str) -> str:
        """Keep a base, and return its name."""
        name = _hash(base.encode() + hash.encode())
        _keep(self._bases, name, _Base(base, hash), self.windows)
        return name

    def _checked(self, command: Mapping[str, Any], old: bytes, new: bytes) -> Mapping[str, Any]:
        window = str(command.get("window"))
        self._explorer.stop(window)
        full, short = str(self.model), self.model.name
        return {
            "findings": [asdict(one) | {"text": one.text.replace(full, short)} for one in self._findings(new, window)]
        }

    def _explored(self, command: Mapping[str, Any], old: bytes, new: bytes) -> Callable[[], Mapping[str, Any]]:
        return partial(self._explorer.explore, str(command.get("window")), new)  # without the lock: it takes long

    def _completed(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """What fits behind the text before the caret in a field of an element, in what the window has checked last."""
        completer = self._completers.get(str(command.get("window")))
        asked = [str(command.get(name, "")) for name in ("element", "field", "before")]
        return asdict(completer.complete(*asked)) if completer is not None else {"length": 0, "words": []}

    def _robot_topics(self) -> RobotTopics:
        """The topics of the robots of the scenario as it is now, and whether the robot publishes them."""
        content = self._now.scenario
        if self._robots[0] is not content:
            found: RobotTopics = {}
            if content is not None and content.world is not None:
                with suppress(FameError):  # which is a finding of the scenario
                    names = [one.name for one in content.world.robots]
                    found = robot_topics(world_topics(content.world, content.seed), names)
            self._robots = content, found
        return self._robots[1]

    def _templates(self) -> list[Mapping[str, Any]]:
        """Templates for what the project has."""
        content = self._now.scenario
        folders, types = (content.library, content.types) if content is not None else ((), ())
        robots = {
            (topic, type, publishes)
            for robot, its in self._robot_topics().items()
            for topic, (type, publishes) in its.items()
            if robot
        }
        made = templates(behaviours([*self._folders, *folders]), message_types([*self._types, *types]), robots)
        return [one for some in made.values() for one in some]

    def _findings(self, content: bytes, window: str) -> list[Finding]:
        """The findings of what is drawn, of other files only the errors: with those nothing can be executed."""
        file = str(self.model)
        try:
            model, now = read_bytes(content, file=file), self._now
            given = known_to_check(now.scenario, model) if now.scenario is not None else {}
            completer = Completer(model, now.library, self._robot_topics, given.get("given", {}))
            _keep(self._completers, window, completer, self.windows)
            bodies = {f"~/{topic}": type for its in self._robot_topics().values() for topic, (type, _) in its.items()}
            found = check(model, library=now.library, bodies=bodies, **given)
        except ModelError as error:
            found = [of_error(error)]
        elsewhere = [Finding("error", str(one), file) for one in found if one.file != file and one.level == "error"]
        return [*elsewhere, *(one for one in found if one.file == file)]

    def _saved(self, command: Mapping[str, Any], old: bytes, new: bytes) -> Mapping[str, Any]:
        if command.get("hash") != _hash(old):
            raise FameError("the file has been changed by somebody else: nothing is written")
        if new != old or not self.model.exists():
            read_bytes(new, file=str(self.model))
            try:
                write_file(self.model, new)
            except OSError as error:
                raise FameError(f"{self.model}: cannot be written: {error.strerror}") from None
        self._last, base = new, self._kept(command["new"], _hash(new))
        return {"base": base, "hash": _hash(new), "text": decoded(self._shown(new), str(self.model))[0]}

    def _compared(self, command: Mapping[str, Any], old: bytes, new: bytes) -> Mapping[str, Any]:
        """What has changed in the file, its text, and that with what the page has drawn; both with a diagram."""
        before, name, now = command.get("text"), self.model.name, self._shown(old)
        if not isinstance(before, str):
            raise FameError("expected the text that the page was given")
        found = compare(read_text(before, file=name), read_bytes(now, file=name))
        said = [] if found.same else list(lines(found))
        text, merged = (decoded(one, str(self.model))[0] for one in (now, now if new == old else new))
        return {"lines": said, "hash": _hash(old), "text": text, "merged": merged}

    def _since_commit(self, command: Mapping[str, Any], old: bytes, new: bytes) -> Mapping[str, Any]:
        """How what is drawn differs from the last commit: in words, and by element."""
        found = compare(*(read_bytes(each, file=self.model.name) for each in (committed(self.model), new)))
        how = {one.element.id: one.how for one in (*found.moved, *found.changes)}
        return {"lines": [] if found.same else list(lines(found)), "how": how}


_Value = TypeVar("_Value")
_Found = Mapping[str, Any]
_Act = Callable[[Mapping[str, Any], bytes, bytes], _Found | Callable[[], _Found]]
"""What a command does with the file as it is, and with what is drawn; or what is still to be done."""


class _Base(NamedTuple):
    """What the editor of a page writes of the file with a hash, unchanged."""

    text: str
    hash: str


_PAGE = files("fame.edit") / "page"


def _keep(those: dict[str, _Value], name: str, value: _Value, most: int) -> None:
    """Add a value, or use it again; of more than `most` those that were used longest ago are forgotten."""
    those.pop(name, None)
    those[name] = value
    while len(those) > most:
        del those[next(iter(those))]


def _is_new(change: ElementChange) -> bool:
    """Whether a change says something else, not only less: what an editor drops stays in the file; it sorts flows."""
    told = not isinstance(change.element, Root)  # where it has only another drawing, and foreign attributes
    values = [(old.split(), new.split()) for name, old, new in change.values if name not in _LEFT_OUT]
    return told and (change.how == "added" or any(new not in ([], old) for old, new in values))


_LEFT_OUT = (ORDER, "executable", "multi instance")
"""What the library says by its own defaults where the file leaves it out; it is not written there."""


def _has_gaps(model: Definitions) -> bool:
    """Whether there is no diagram, or one in which elements are missing."""
    drawn = {one.element for one in model.shapes} | {one.element for one in model.edges}
    bodies = [body for process in model.processes for body in process.body.bodies()]
    groups = [{one.id for one in (*body.nodes, *body.flows)} for body in bodies]
    if not {process.id for process in model.processes} & {*model.planes}:
        groups.append(drawn | {one.id for one in model.participants})
    return not model.shapes or any(drawn & ids and not ids <= drawn for ids in groups)


def _is_camunda8(content: bytes, file: str) -> bool:
    """Whether a file says that it is of Camunda 8, or has its extensions and none of Camunda 7."""
    root = parse(content, file)
    if (platform := root.get(_PLATFORM)) is not None:
        return platform == "Camunda Cloud"
    names = {str(name) for one in root.iter("*") for name in (one.tag, *one.keys())}
    used = {name[1:].partition("}")[0] for name in names if name[0] == "{"}
    return ZEEBE in used and CAMUNDA not in used


def _hash(content: bytes) -> str:
    return sha256(content).hexdigest()
