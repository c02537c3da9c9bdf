"""The page of a team on the network: the events that its engines publish, as blocks.

Robots may come and go; one that says nothing for some seconds is lost. With control, the page completes and activates
tasks, repairs what robots run, suspends and steers them, as `fame complete` and the others do; each robot decides
whether it obeys.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError, TimeoutError as NoAnswer
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

from fame.bpmn.model import Definitions
from fame.bpmn.reader import read
from fame.clock import SECOND, Scheduler
from fame.closing import Closing
from fame.deploy import STATUS_QOS, STRING, Deployment, Report
from fame.deploy.options import DeploymentOptions
from fame.deploy.requests import ACTS, TaskClient, TaskRequest
from fame.deploy.sender import Sender
from fame.errors import FameError, ModelError
from fame.log.live_team import RESTARTED
from fame.log.recording import team_order
from fame.log.team_recorder import RecordingJudge, TeamRecorder, TeamRecorderOptions
from fame.middleware.interface import AnyMessage, Middleware, Publisher, QoS, resolve
from fame.text import read_json
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.change import ModelChange
from fame.view.mission import mission_json, place_of
from fame.view.sink import PageSink
from fame.view.steering import MANUAL, TWIST, twist_of

_T = TypeVar("_T")
_ANSWER = 5.0
"""Seconds that a robot has to answer a command."""
_SILENCE = 5 * SECOND
"""After how long without a status a robot is lost (ns)."""
_BATTERY = "sensor_msgs/msg/BatteryState"
_LATEST = QoS(reliability="best_effort", depth=1)
_TICK = SECOND // 10
"""Steps in which time goes on while nothing happens (ns)."""
_BEHIND = SECOND // 2
"""How far it stays behind, for what is still on its way (ns)."""
_DELAY = SECOND // 20
"""How long batches wait for those of other robots (ns): engines send 20 a second."""


class TeamView(PageSink, Closing):
    """The source of a page that shows the robots on a network, or those named in `robots`.

    `control` lets the page ask robots for something (`TaskRequest`), signed with `key` if there is one, for somebody
    (`who`); `allow_change` lets it send them models, too; `judging` judges properties. All that comes over the network
    comes in the thread of the scheduler; pages ask from others.
    """

    def __init__(
        self,
        middleware: Middleware,
        scheduler: Scheduler,
        *,
        robots: frozenset[str] = frozenset(),
        control: bool = False,
        key: Any = None,
        judging: RecordingJudge | None = None,
        who: str = "",
    ) -> None:
        super().__init__(Catalogue([]))
        self._scheduler, self._control, self._key, self._who = scheduler, control, key, who
        self.change: ModelChange | None = None
        self._models: dict[bytes, int] = {}  # source of a model -> number of its file
        self._missions = 0
        self._middleware = middleware
        self._heard: dict[
            str, tuple[int, int]
        ] = {}  # robot -> when its last status came, and the time of the page then
        self._leases: dict[str, str] = {}  # robot -> lease of the page that steers it
        self._hands: dict[str, Publisher] = {}  # with which pages have steered robots
        self._charges: dict[str, float] = {}  # of the batteries that are watched, as told last
        options = TeamRecorderOptions(robots=robots, models=False, delay=_DELAY)
        self._recorder = TeamRecorder(
            middleware, scheduler, lambda: self, options, on_model=self._on_model, judging=judging
        )
        self._node = middleware.node("fame_view")

    def allow_change(self, path: Path | None = None, library: Sequence[Path] = ()) -> None:
        """Let the page deploy models, and migrate what runs: one that is dropped on it, or the file at `path`."""
        self.change = ModelChange(
            self._deploy, self._running, robots=lambda: sorted(self._recorder.team.models), path=path, library=library
        )

    def close(self) -> None:
        """Close all endpoints."""
        if self.change is not None:
            self.change.close()
        self._recorder.close()
        self._node.close()

    # ---- what comes over the network ---------------------------------------------------------------------------------

    def put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        with self._lock:
            packer = self._packer
            known = len(packer.robots), len(packer.state.poses)
            super().put(topic, time, data)
            self._missions += known != (len(packer.robots), len(packer.state.poses))
            self._meet()

    def _order(self) -> list[str]:
        """The robots in the order that a recording of them has."""
        packer = self._packer
        return team_order(packer.robots, (packer.robots[robot] for robot in packer.state.poses))

    def _meet(self) -> None:
        """Listen to the status of robots that are new: their model or their first event came."""
        for robot in self._packer.robots[len(self._heard) :]:
            self._heard[robot] = self._scheduler.now, self._time()
            take = partial(self._on_status, robot)
            self._node.subscription(f"/{robot}/bpmn_status", STRING, take, STATUS_QOS)

    def _on_status(self, robot: str, message: AnyMessage) -> None:
        """A robot is there; each second is often enough to look at its battery."""
        with self._lock:
            self._heard[robot] = self._scheduler.now, self._time()
        topic = f"/{robot}/battery_state"
        there = any(info.name == topic and _BATTERY in info.types for info in self._middleware.graph())
        if there and robot not in self._charges:
            self._charges[robot] = -1.0
            self._node.subscription(topic, _BATTERY, partial(self._on_battery, robot, topic), _LATEST)

    def _on_battery(self, robot: str, topic: str, message: AnyMessage) -> None:
        """Show the charge of a robot, if it has changed by a percent."""
        charge = round(float(message.percentage), 2)
        with self._lock:
            if charge != self._charges[robot] and self._packer.blocks:
                self._charges[robot] = charge
                self._packer.message(self._packer.end, topic, robot, {"percentage": charge})

    def _lost(self) -> dict[str, int]:
        """The robots that left the network, said nothing for some time, lost their mission, or speak another protocol,
        and since when (ns)."""
        silent, team = self._scheduler.now - _SILENCE, self._recorder.team
        lost = {robot: end for robot, (heard, end) in self._heard.items() if robot in team.gone or heard < silent}
        return {**team.restarted, **dict.fromkeys(team.foreign, 0), **lost}

    def _on_model(self, robot: str, model: Mapping[str, Any]) -> None:
        """Add the model that a robot runs."""
        with self._lock:
            packer, files = self._packer, list[int]()
            for each in model.get("models", ()):
                source = str(each["xml"]).encode()
                with suppress(ModelError):
                    if source not in self._models:
                        packer.catalogue.extend([read(source, file=str(each["name"]))])
                        self._models[source] = len(packer.catalogue.files) - 1
                files.append(self._models.get(source, NOWHERE))
            packer.run(packer.robot(robot), files)
            self._meet()
            self._missions += 1

    # ---- for the page ------------------------------------------------------------------------------------------------

    def mission(self) -> Mapping[str, Any]:
        with self._lock:
            packer, team, version = self._packer, self._recorder.team, self._version()
            found = mission_json(
                "live",
                "Team",
                packer.catalogue,
                packer.robots,
                chips=[("live", "live", "what the engines on the network tell")],
                notices=[
                    *(f"{robot} has left the network: what it did last is shown" for robot in sorted(team.gone)),
                    *(f"{robot}: {RESTARTED}" for robot in sorted(team.restarted)),
                    *team.foreign.values(),
                    *(f"{count} batches of {robot} were lost" for robot, count in team.gaps.items()),
                ],
                blocks=packer.index(),
                end=self._time(),
                control=([*ACTS, "steer"] if self._control else []) + (["change"] if self.change is not None else []),
                messages=True,
                version=version,
                order=[packer.robots.index(robot) for robot in self._order()],
                empty=[
                    "No robot on the network yet",
                    "Start an engine with fame engine NAME and send it a mission with fame deploy, or run a scenario "
                    "with fame run --middleware dds. Robots appear here as they come.",
                ],
            )
            for number, robot in enumerate(found["robots"]):
                robot |= place_of(packer, number, str(team.models.get(robot["name"], {}).get("process", "")))
            return found

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        with self._lock:
            lost = self._lost()
            status = {"type": "run", "time": self._time(), "over": False, "breakpoints": [], "lost": lost}
            return self.growth(known, status, self._version())

    def _version(self) -> str:
        """The version of the mission."""
        team = self._recorder.team
        return repr((self._missions, *team.gaps.items(), *sorted(team.gone), *team.restarted.items(), *team.foreign))

    def _time(self) -> int:
        """How far the team has come (ns), also while nothing happens."""
        now = self._recorder.now + self._recorder.team.ahead - _BEHIND
        return max(self._packer.end, now // _TICK * _TICK if self._packer.blocks else 0)

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        if not self._control:
            raise FameError("this page only shows the team: fame view --control lets it control robots")
        if command.get("do") == "change" and self.change is not None:
            self.change.take(str(command.get("name")), str(command.get("source")))
            return {}
        act, robot = command.get("do"), str(command.get("robot", ""))
        if act not in (*ACTS, "steer") or robot not in self._packer.robots:
            raise FameError(f"expected one of {', '.join(ACTS)} and the name of a robot, got {act!r} of {robot!r}")
        if act == "steer":
            return self._steer(robot, command)
        request = _request(str(act), command)
        report = self._send(robot, request)
        if report.answer == "refused" or act in ("suspend", "continue", "fail"):
            self._leases = {name: lease for name, lease in self._leases.items() if lease != request.lease}
        if report.answer == "refused":
            raise FameError(f"{robot} refused: {report.reason}")
        said = {"said": f"{robot}: {report.answer}{f': {report.reason}' if report.reason else ''}"}
        if act != "take_over":
            return said
        self._leases[robot] = request.lease
        return said | {"steers": self._call(lambda: self._hand(robot))}

    def _hand(self, robot: str) -> bool:
        """Make the publisher that steers a robot; gives whether somebody listens to it."""
        topic = resolve(MANUAL, robot)
        if robot not in self._hands:
            self._hands[robot] = self._node.publisher(topic, TWIST)
        return any(info.name == topic and info.subscribers for info in self._middleware.graph())

    def _steer(self, robot: str, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """Publish what a person who has taken a robot over wants it to do."""
        if not command.get("lease") or self._leases.get(robot) != command["lease"]:
            raise FameError(f"this page does not steer {robot}: take over first")
        twist = twist_of(command)
        self._scheduler.soon(lambda: self._hands[robot].publish(twist))
        return {}

    def _call(self, action: Callable[[], _T]) -> _T:
        """Call something in the thread of the scheduler."""
        answer: Future[_T] = Future()

        def act() -> None:
            try:
                answer.set_result(action())
            except Exception as error:  # who asked is told
                answer.set_exception(error)

        self._scheduler.soon(act)
        try:
            return answer.result(_ANSWER)
        except NoAnswer:
            raise FameError(f"the network has not answered within {_ANSWER:g} s") from None

    def _running(self, robot: str) -> str:
        """The file that a robot runs, with all that it calls; empty if it runs nothing."""
        team = self._recorder.team
        models = team.models.get(robot, {}).get("models", ()) if robot not in team.restarted else ()
        return str(models[0]["xml"]) if models else ""

    def _deploy(
        self, model: Definitions, options: DeploymentOptions, ended: Callable[[Deployment], object]
    ) -> Deployment:
        """Send a model to the robots that the page shows, and tell when that has ended."""
        options = replace(options, key=self._key, who=self._who)

        def over(deployment: Deployment) -> None:
            self._scheduler.soon(deployment.close)
            ended(deployment)

        sender = Sender(f"view-{uuid4().hex[:8]}", self._scheduler, self._middleware, options)
        return self._call(lambda: sender.send(model, over))

    def _send(self, robot: str, request: TaskRequest) -> Report:
        """The answer of a robot to a request."""
        answer: Future[Report] = Future()
        clients: list[TaskClient] = []

        def answered(report: Report) -> None:
            with suppress(InvalidStateError):
                answer.set_result(report)

        def ask() -> None:
            node, scheduler = self._node, self._scheduler
            clients.append(TaskClient(robot, request, node=node, scheduler=scheduler, answered=answered, key=self._key))

        self._scheduler.soon(ask)
        try:
            return answer.result(_ANSWER)
        except NoAnswer:
            raise FameError(f"{robot} has not answered within {_ANSWER:g} s") from None
        finally:
            self._scheduler.soon(lambda: _close(clients))


def _request(act: str, command: Mapping[str, Any]) -> TaskRequest:
    """The request of a command. Raises FameError."""
    text = command.get("value") or ("null" if act == "set" else "{}")
    try:
        values = read_json(text)
    except ValueError:
        raise FameError(f"expected values as JSON, got {text!r}") from None
    element, to, lease = (str(command.get(name, "")) for name in ("element", "to", "lease"))
    who = str(command.get("who") or "a page")
    if act == "set":
        if not command.get("name"):
            raise FameError("expected the name of a variable")
        return TaskRequest(id=uuid4().hex, act=act, element="", values={str(command["name"]): values}, who=who)
    if act == "note":
        to = str(command.get("text", ""))
    if not isinstance(values, dict):
        raise FameError('expected values as a JSON object, as {"approved": true}')
    if act == "move" and not to:
        raise FameError("expected the element that the token moves to")
    return TaskRequest(id=uuid4().hex, act=act, element=element, values=values, to=to, who=who, lease=lease)


def _close(clients: list[TaskClient]) -> None:
    for client in clients:
        client.close()
