"""The page of a model that a running team could change to: what it would do to every token, before anything is sent.

Whenever the model is saved, or another one is dropped on the page, the robots are asked what would become of what they
run (a dry run: nothing changes), the model is compared with what they run, and the state that they would have is
explored. Only then it can be deployed, or what runs migrated: by a command with the hash of exactly what was shown.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, TimeoutError as NoAnswer
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from fame.bpmn.difference import ElementChange, difference
from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.reader import read_text
from fame.bpmn.split import split
from fame.dataclasses import dataclass, field, replace
from fame.errors import FameError
from fame.view.catalogue import NOWHERE
from fame.view.watch import ModelWatch

if TYPE_CHECKING:
    from fame.check.explore import Exploration
    from fame.deploy import Deployment
    from fame.deploy.options import DeploymentOptions

PATIENCE = 5.0
"""How long robots may take to answer (s), on a machine that is not busy."""
_STRONGEST = ("removed", "added", "changed", "moved")

BeginDeployment = Callable[[Definitions, "DeploymentOptions", Callable[["Deployment"], object]], object]
"""Begins a deployment, in the thread of the network; calls back when it has ended. Raises FameError."""


@dataclass(slots=True)
class _Examination:
    """What is known of a model. `model` is None if it cannot be read; `error` is why nothing can be sent."""

    model: Definitions | None = None
    library: Library = field(default_factory=Library)
    hash: str = ""
    asking: bool = False
    error: str = ""
    dry: Deployment | None = None
    changes: list[tuple[ElementChange, list[str]]] = field(default_factory=list)
    exploration: Exploration | None = None
    unexplored: str = ""


class ModelChange(ModelWatch):
    """The source of that page. `send` sends to the team, `running` gives the XML that a robot runs, or nothing.

    `path` is watched, as while it is drawn; without it the page waits for a model that is dropped (`take`).
    """

    def __init__(
        self,
        send: BeginDeployment,
        running: Callable[[str], str],
        *,
        robots: Callable[[], Iterable[str]] = tuple,
        path: Path | None = None,
        library: Sequence[Path] = (),
    ) -> None:
        self._send, self._running, self._team = send, running, robots
        self._about = _Examination()
        self._folder = TemporaryDirectory(prefix="fame-view-")
        super().__init__(path or Path(self._folder.name, "model.bpmn"), library, wait=True)

    def close(self) -> None:
        """Stop watching; what was dropped is removed."""
        super().close()
        self._folder.cleanup()

    def take(self, name: str, source: str) -> None:
        """Watch a model that was dropped on the page, in place of the one before."""
        stem = re.sub(r"[^\w.-]+", "_", Path(name).stem).strip("._")
        path = Path(self._folder.name, f"{stem or 'model'}.bpmn")
        path.write_text(source, encoding="utf-8")
        self._path = path
        self._about = _Examination(asking=True)  # nobody deploys the one before, taking it for this one
        self._version += 1

    # ---- what would happen -------------------------------------------------------------------------------------------

    def on_read(self) -> None:
        """Examine the model that was read."""
        about = self._about = _Examination(asking=True)
        self._version += 1
        try:
            self._examine(about)
        except FameError as error:
            about.error = str(error)
        except Exception as error:  # the next model is examined all the same
            about.error = f"it could not be examined: {type(error).__name__}: {error}"
        about.asking = False
        self._version += 1

    def _examine(self, about: _Examination) -> None:
        model, about.library = self._now.model, self._now.library
        if model is None:
            raise FameError(str(self._now.findings[0]))
        about.hash = _hash(model, about.library)
        about.model = model
        about.dry = self._sent(about, migrate=True, preview=True)
        self._compare(about)
        if any(one.tokens for one in about.dry.foreseen.values()):
            try:
                about.exploration = _explored(about, about.dry.pools, about.dry.foreseen)
            except FameError as error:
                about.unexplored = str(error)

    def _sent(self, about: _Examination, *, migrate: bool, preview: bool = False, force: bool = False) -> Deployment:
        """The deployment of a model, once it has ended. Raises FameError."""
        from fame.deploy.options import DeploymentOptions
        from fame.middleware.wire_base import load_of_machine

        assert about.model is not None
        ended: Future[Deployment] = Future()
        plan = {"forced": True} if force else {}
        patience = PATIENCE * load_of_machine()
        wanted = DeploymentOptions(
            library=about.library, patience=patience, migrate=migrate, plan=plan, preview=preview
        )
        if migrate and not preview and not force:
            wanted = replace(wanted, approve=self._approval(about))
        self._send(about.model, wanted, ended.set_result)
        try:
            return ended.result(3 * patience)
        except NoAnswer:
            raise FameError("the robots have not answered") from None

    def _compare(self, about: _Examination) -> None:
        """Compare what each robot runs with its part of the model: called processes are in both."""
        assert about.dry is not None
        for robot, envelope in about.dry.envelopes.items():
            runs, new = self._running(robot), read_text(envelope.model, file=robot)
            old = read_text(runs, file=f"{robot} now") if runs else Definitions(file=robot, source=b"")
            for change in difference(old, new):
                alike = (robots for one, robots in about.changes if _is_alike(one, change))
                if (robots := next(alike, None)) is None:  # robots that run different versions get different code
                    about.changes.append((change, robots := []))
                robots.append(robot)

    # ---- for the page ------------------------------------------------------------------------------------------------

    def mission(self) -> Mapping[str, Any]:
        version, about = self._version, self._about  # in this order: what changes in between is news
        can = ["deploy", "migrate", "examine"] if about.hash and not about.asking else []
        return {**super().mission(), "control": can, "change": self._change_json(about), "version": version}

    def _change_json(self, about: _Examination) -> dict[str, Any]:
        rows = [self._row(change, robots) for change, robots in about.changes]
        rows.sort(key=lambda row: _STRONGEST.index(row["how"]))
        return {
            "hash": about.hash,
            "asking": about.asking,
            "error": about.error,
            "robots": list(self._robots(about)),
            "others": self._others(about),
            "changes": rows,
            "objection": self._objection(about),
            "explored": self._explored_json(about.exploration) if about.exploration is not None else None,
            "ghosts": self._ghosts(about),
        }

    def _explored_json(self, explored: Exploration) -> dict[str, Any]:
        """What may follow a migration, each finding with the run that leads to it."""
        text = explored.summary().replace(str(self._path), self._path.name)
        findings = [{"level": one.level, "text": one.text, "steps": list(one.steps())} for one in explored.findings]
        return {"text": text, "findings": findings}

    def _row(self, change: ElementChange, robots: Sequence[str]) -> dict[str, Any]:
        element = change.element
        return {
            "element": self._number(element.id) if change.how != "removed" else NOWHERE,
            "id": element.id,
            "name": element.label,
            "tag": element.tag,
            "how": change.how,
            "what": list(change.what),
            "code": [list(change.old_texts), list(change.new_texts)],
            "robots": list(robots),
        }

    def _number(self, id: str) -> int:
        return next(iter(self._now.catalogue.candidates(id)), NOWHERE)

    def _robots(self, about: _Examination) -> Iterator[dict[str, Any]]:
        """What would become of each robot, token by token."""
        for robot in about.dry.robots.values() if about.dry is not None else ():
            foreseen = about.dry.foreseen.get(robot.robot) if about.dry is not None else None
            tokens = [
                {"element": self._number(token.target or token.element), "name": token.name or token.element}
                | {"fate": token.fate, "target": token.target, "reason": token.reason}
                for token in (foreseen.tokens if foreseen is not None else ())
            ]
            runs = foreseen.hash if foreseen is not None else ""
            yield {"robot": robot.robot, "state": robot.state, "reason": robot.reason, "runs": runs, "tokens": tokens}

    def _others(self, about: _Examination) -> list[str]:
        """The robots that run something, and for which the model has no pool."""
        known = about.dry.robots if about.dry is not None else {}
        return [robot for robot in self._team() if robot not in known and self._running(robot)] if known else []

    def _objection(self, about: _Examination) -> str:
        """Why what runs should not migrate, or nothing."""
        from fame.scenario.explore.exploration import objection

        if about.dry is None or about.error:
            return about.error
        blocked = [f"{robot}: {one.blocked}" for robot, one in about.dry.foreseen.items() if one.blocked]
        blocked += [f"{one.robot}: {one.reason}" for one in about.dry.robots.values() if one.state != "previewed"]
        if blocked or about.unexplored:
            return "; ".join(blocked) or about.unexplored
        return objection(about.exploration) if about.exploration is not None else ""

    def _ghosts(self, about: _Examination) -> list[dict[str, Any]]:
        """Where removed shapes were, in the drawing of the mission."""
        gone = {one.element.id: one.element for one, _ in about.changes if one.how == "removed"}
        if not gone or about.model is None or not self._now.catalogue.drawings:
            return []
        boxes = self._now.catalogue.drawings[0].boxes
        same = (one for one in about.model.shapes if one.element in boxes and not one.plane)
        shifts = ((boxes[one.element][0] - one.bounds.x, boxes[one.element][1] - one.bounds.y) for one in same)
        dx, dy = next(shifts, (0.0, 0.0))
        files = filter(None, {self._running(robot) for _, robots in about.changes for robot in robots})
        shapes = {one.element: one for text in files for one in read_text(text, file="now").shapes if not one.plane}
        return [
            {"name": element.label, "box": [box.x + dx, box.y + dy, box.width, box.height]}
            for id, element in gone.items()
            if id in shapes
            for box in (shapes[id].bounds,)
        ]

    # ---- commands ----------------------------------------------------------------------------------------------------

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """``deploy`` or ``migrate`` what was shown, by its hash (`force`: despite an objection); ``examine`` again."""
        act, about = command.get("do"), self._about
        if act == "examine":
            self._stamps = {}
            return {}
        if act not in ("deploy", "migrate"):
            raise FameError("expected deploy or migrate")
        if not about.hash or about.asking or about.model is None:
            raise FameError("this model cannot be sent")
        if command.get("hash") != about.hash or _hash(about.model, about.library) != about.hash:
            self._stamps = {}
            raise FameError("the model has changed since it was shown: look at it again")
        done = self._sent(about, migrate=act == "migrate", force=command.get("force") is True)
        text = "; ".join(
            f"{one.robot}: {one.state}{f' ({one.reason})' if one.reason else ''}" for one in done.robots.values()
        )
        if done.failed:
            raise FameError(f"nothing has changed: {text}" if not done.started else f"not all have started: {text}")
        return {"said": text}

    def _approval(self, about: _Examination) -> Callable[..., str]:
        """Explore the state that robots have when they are held: it may be another one than that of the dry run."""

        def approve(pools: Any, foreseen: Any) -> str:
            from fame.scenario.explore.exploration import objection

            try:
                return objection(_explored(about, pools, foreseen))
            except FameError as error:
                return str(error)

        return approve


def _is_alike(one: ElementChange, other: ElementChange) -> bool:
    same = one.element.id == other.element.id and (one.how, one.what) == (other.how, other.what)
    return same and (one.old_texts, one.new_texts) == (other.old_texts, other.new_texts)


def _explored(about: _Examination, pools: Any, foreseen: Any) -> Exploration:
    """The exploration of what robots would have after a migration. Raises FameError."""
    from fame.scenario.explore.exploration import explore_migrated

    assert about.model is not None
    return explore_migrated(about.model, about.library, pools, foreseen)


def _hash(model: Definitions, library: Library) -> str:
    """The hash of everything that robots would be sent. Raises ModelError."""
    whole = sha256()
    for part in split(model, library):
        whole.update(sha256(part.source).digest())
    return whole.hexdigest()
