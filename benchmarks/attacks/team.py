"""A team of real engines under attack, and its history in the form that the invariants of simulated teams judge.

The attacks strike at moments of a deployment (`Team.at`). After the last one `Team.judge` heals what is left, waits
until nothing is under way any more, and applies `tests.torture.invariants`.
"""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from attacks.field import START, WAIT, Engine, Field, Forked, held, model, process
from fame.deploy import STATUS_QOS, STRING, Report
from fame.deploy.envelope import PROCESS_QOS, read_envelope
from fame.errors import DeploymentError
from tests.torture.invariants import broken_promises, forgotten, mixed, strangers
from tests.torture.team import STRANGER, Said

PATIENCE = 90.0
"""How long a team may need until nothing is under way any more after the last fault (s). Participants of DDS that took
each other for dead may find each other only after half a minute."""
TRIES = 3
"""How often a person deploys again whose robots say that the sender fell silent, as it does for want of a processor."""


def mission(version: int, robots: Iterable[str], *, tasks: int = 0, fleet: str = "") -> str:
    """A version of a mission: all wait for `go` of the first, which has `tasks` more to load.

    A `fleet` is a pool for all robots of that name and a number.
    """
    first, *others = robots
    pools = "".join(f'<participant id="P{robot}" name="{robot}" processRef="p{robot}"/>' for robot in (first, *others))
    if fleet:
        others.append(fleet)
        pools += f'''<participant id="P{fleet}" name="{fleet}" processRef="p{fleet}">
            <participantMultiplicity minimum="1"/></participant>'''
    throws = '<intermediateThrowEvent id="t"><signalEventDefinition signalRef="S"/></intermediateThrowEvent>'
    catches = '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/></intermediateCatchEvent>'
    mark = f'<task id="version{version}"/>'
    more = [f'<task id="more{number}"/>' for number in range(tasks)]
    own = lambda robot, *elements: (element.replace('id="', f'id="{robot}_') for element in elements)  # noqa: E731
    return model(
        '<signal id="S" name="go"/>',
        f'<collaboration id="c{version}">{pools}</collaboration>',
        process(f"p{first}", *own(first, START, mark, throws, WAIT, *more)),
        *(process(f"p{robot}", *own(robot, START, mark, catches, WAIT)) for robot in others),
    )


@dataclass
class Robot:
    """A robot as the invariants see it: `engine` is its last report, or None while its process is dead.

    There it runs a version: whoever joins late gets that with a deployment of its own.
    """

    name: str
    versions: dict[str, str]  # of each deployment
    process: Engine | Forked
    durable: bool = False
    spoilt: bool = False
    reports: int = 0
    last: Report | None = None

    @property
    def engine(self) -> Report | None:
        if self.last is None or not self.process.alive:
            return None
        return replace(self.last, deployed=self.versions.get(self.last.deployed, self.last.deployed))

    @property
    def at_rest(self) -> bool:
        """Whether no deployment is under way."""
        report = self.engine
        return report is not None and not report.candidate and report.state not in ("loading", "ready", "holding")


@dataclass
class Sender:
    """A ``fame deploy`` of a version, in a process of its own."""

    version: int
    process: subprocess.Popen[str]
    stranger: bool = False
    begun: float = field(default_factory=time.monotonic)
    said: str = ""

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    @property
    def outcome(self) -> str:
        """Its exit code and what it said."""
        if not self.said:
            with suppress(ValueError):
                self.said = "\n".join(filter(None, self.process.communicate())).strip()
        return f"exit code {self.process.returncode}: {self.said}"

    def owns(self, deployment: str) -> bool:
        return deployment.startswith(f"deploy-{self.process.pid}-")


class Team:
    """Engines of some `names`, each with the options `words`; those that are `durable` have a directory.

    A `fleet` is a pool for all robots of that name and a number. One command starts all of them `together`.
    """

    def __init__(
        self,
        field: Field,
        names: Iterable[str],
        *words: str,
        durable: Collection[str] = (),
        fleet: str = "",
        together: bool = False,
    ) -> None:
        self.field, self.words, self.fleet = field, words, fleet
        self.robots: dict[str, Robot] = {}
        self.senders: list[Sender] = []
        self.said: list[Said] = []
        self.on_sent: Callable[[str, str], object] = lambda robot, text: None
        self.sent: list[tuple[str, str]] = []  # to which robot, and what
        self.phases: list[tuple[str, str, str]] = []  # phase, robot, deployment: what was sent
        self.sequences: dict[str, int] = {}
        self.versions: dict[str, str] = {}
        self.released: set[tuple[str, str]] = set()
        self.unwritten: frozenset[str] = frozenset()
        self._versions = itertools.count(1)
        if together:
            self._fork(*names)
        else:
            for name in names:
                self.start(name, durable=name in durable)
        self.await_robots()

    def _fork(self, *names: str) -> None:
        """Start all engines by one command."""
        parent = Engine(
            names[0], (*names[1:], *self.field.words, *self.words), self.field.environment, self.field.folder, None
        )
        self.field.engines.append(parent)
        children = Path(f"/proc/{parent.process.pid}/task/{parent.process.pid}/children")
        held(self.field.until(lambda: len(children.read_text().split()) == len(names), PATIENCE), "not all were forked")
        for name, pid in zip(names, children.read_text().split(), strict=True):
            self.robots[name] = Robot(name, self.versions, Forked(name, int(pid)))
            self._listen(name)

    def start(self, name: str, *, durable: bool = False) -> None:
        """Start an engine; hear what it says, and what is said to it."""
        self.robots[name] = Robot(name, self.versions, self._engine(name, durable=durable), durable)
        self._listen(name)

    def _listen(self, name: str) -> None:
        stranger = self.field.stranger
        stranger.subscription(f"/{name}/bpmn_status", STRING, lambda said: self._on_report(name, said), STATUS_QOS)
        stranger.subscription(f"/{name}/bpmn_process", STRING, lambda said: self._on_sent(name, said), PROCESS_QOS)

    def _engine(self, name: str, *, durable: bool) -> Engine:
        state = ("--state", str(self.field.folder / f"{name}.state")) if durable else ()
        words, where = (*self.field.words, *self.words, *state), self.field.elsewhere.get(name, ())
        engine = Engine(name, words, self.field.environment, self.field.folder, None, where)
        self.field.engines.append(engine)
        return engine

    def await_robots(self, within: float = PATIENCE) -> None:
        """Wait until every engine has spoken."""
        silent = lambda: [robot for robot in self.robots.values() if not robot.reports and robot.process.alive]  # noqa: E731
        held(self.field.until(lambda: not silent(), within), f"never spoke: {[robot.name for robot in silent()]}")

    def restart(self, name: str) -> None:
        """Start the engine of a robot again that was killed."""
        robot = self.robots[name]
        robot.reports, robot.last = 0, None
        robot.process = self._engine(name, durable=robot.durable)

    # ---- history -----------------------------------------------------------------------------------------------------

    def _on_report(self, name: str, message: Any) -> None:
        report, robot = Report.from_json(message.data), self.robots.get(name)
        if report is None or robot is None:
            return
        robot.reports += 1
        robot.last = report
        if report.answer and report.deployment:
            by = f"{name}#{report.born}"
            self.said.append(Said(time.monotonic(), name, by, report.answer, report.deployment, report.reason))

    def _on_sent(self, name: str, message: Any) -> None:
        with suppress(DeploymentError):
            envelope = read_envelope(message.data, name, time.time())
            self.sequences[envelope.deployment] = envelope.sequence
            if envelope.model:
                self.versions[envelope.deployment] = re.findall("version[0-9]+", envelope.model)[0]
            self.phases.append((envelope.phase, name, envelope.deployment))
            self.sent.append((name, message.data))
            self.on_sent(name, message.data)

    # ---- deployments -------------------------------------------------------------------------------------------------

    def write(self, tasks: int = 0) -> tuple[int, str]:
        """The next version, and its file."""
        version = next(self._versions)
        names = [name for name in self.robots if not self.fleet or not name.startswith(f"{self.fleet}_")]
        text = mission(version, names, tasks=tasks, fleet=self.fleet)
        return version, self.field.file(f"version{version}.bpmn", text)

    def deploy(self, *words: str, stranger: bool = False, tasks: int = 0) -> Sender:
        """Begin to deploy the next version, perhaps as a `stranger`."""
        version, file = self.write(tasks)
        sender = Sender(version, self.field.begin("deploy", file, *words), stranger)
        if "--stay" not in words:
            self.senders.append(sender)
        return sender

    def at(self, moment: str, sender: Sender, within: float = PATIENCE) -> bool:
        """Wait for a moment of a deployment: ``load`` is sent, ``A ready`` is answered, ... Whether it came."""
        robot, _, answer = moment.rpartition(" ")
        version = f"version{sender.version}"

        def came() -> bool:
            if robot:
                found = ((said.robot, said.answer, said.deployment) for said in self.said)
            else:
                found = (("", phase, deployment) for phase, _, deployment in self.phases)
            return any(
                who == robot and what == answer and self.versions.get(which) == version for who, what, which in found
            )

        self.field.until(lambda: came() or not sender.alive, within)
        return came()

    # ---- the end -----------------------------------------------------------------------------------------------------

    def settle(self, *, released: bool = False) -> list[str]:
        """Wait until nothing is under way any more; the names of the robots that hold until they are `released`."""
        heard = {name: robot.reports for name, robot in self.robots.items()}

        def there() -> list[Robot]:
            return [robot for robot in self.robots.values() if robot.process.alive]

        def fresh() -> bool:
            return all(robot.reports > heard[robot.name] + 2 for robot in there())

        def settled() -> bool:
            return fresh() and all(robot.at_rest for robot in there()) and not any(one.alive for one in self.senders)

        def stays() -> bool:
            """Whether all that is left are robots that wait for what engines promised that are no more."""
            left = [robot for robot in there() if not robot.at_rest]
            holds = lambda robot: robot.last.state == "holding" and "was started anew" in self.why_it_holds(robot.name)  # noqa: E731
            return not released and bool(left) and fresh() and all(map(holds, left))

        self.field.until(lambda: settled() or stays(), PATIENCE)
        for sender in self.senders:
            held(not sender.alive, f"the sender of version {sender.version} has not ended after {PATIENCE:g} s")
        restless = [robot for robot in self.robots.values() if robot.process.alive and not robot.at_rest]
        for robot in restless:
            report = robot.last
            held(report is not None and report.state == "holding", f"{robot.name} is {report and report.state}")
        return [robot.name for robot in restless]

    def await_version(self, version: int, within: float = PATIENCE) -> None:
        """Wait until all robots run a version."""

        def others() -> dict[str, str]:
            runs = {name: self._engines().get(name, ("", ""))[0] or "" for name in self.robots}
            return {name: deployed for name, deployed in runs.items() if deployed != f"version{version}"}

        held(self.field.until(lambda: not others(), within), f"not all run version {version}: {others()}")

    def judge(self) -> None:
        """Raise Fell for what does not hold now that no fault is left."""
        for engine in (robot.process for robot in self.robots.values()):
            if engine.alive:
                engine.tell(signal.SIGCONT)
        for sender in self.senders:
            if sender.alive:
                sender.process.send_signal(signal.SIGCONT)
        holding = self.settle()
        self._hold(*strangers(self._of_strangers()))
        self._hold(*broken_promises(self), *mixed(self._engines()), *forgotten(self))  # type: ignore[arg-type]
        for name in holding:
            if not self.robots[name].at_rest:
                self.release(name)
        if holding:
            held(not self.settle(released=True), f"{holding} hold although a person has aborted")
        self._hold(*broken_promises(self), *mixed(self._engines()))  # type: ignore[arg-type]
        self._hold(*self._betrayed())

    def finish(self, *words: str) -> None:
        """A new deployment starts on all robots; on a busy machine one of the first may be called off, by all."""
        for _ in range(TRIES):
            sender = self.deploy(*words)
            self.field.until(lambda sender=sender: not sender.alive, 2 * PATIENCE)
            held(not sender.alive, "a new deployment does not end on a healthy team")
            if sender.process.returncode == 0:
                break
            self.judge()
        held(sender.process.returncode == 0, f"a new deployment fails on a healthy team: {sender.outcome}")
        self.judge()

    def _engines(self) -> dict[str, tuple[str | None, str]]:
        """Version and state of each engine."""
        engines = {name: robot.engine for name, robot in self.robots.items()}
        return {name: (engine.deployed or None, engine.state) for name, engine in engines.items() if engine is not None}

    def _of_strangers(self) -> Any:
        """What was said, and the senders that no key of the team has signed, by the names of their deployments."""
        mine = [sender for sender in self.senders if sender.stranger]
        deployments = [which for which in self.sequences if any(sender.owns(which) for sender in mine)]
        found = [SimpleNamespace(version=STRANGER, process=SimpleNamespace(name=which)) for which in deployments]
        return SimpleNamespace(said=self.said, senders=found)

    def _betrayed(self) -> Iterator[str]:
        """What a sender said that it had started runs, or something newer."""
        done = [sender for sender in self.senders if sender.process.returncode == 0]
        known = {
            which: number for which, number in self.sequences.items() if any(sender.owns(which) for sender in done)
        }
        newest = max(known, key=known.__getitem__, default="")
        for robot in self.robots.values():
            runs = robot.last.deployed if robot.last is not None else ""
            if runs and newest and self.sequences.get(runs, 0) < known[newest]:
                yield f"{robot.name} runs {runs}, although the sender of {newest} said that all have started that"

    def why_it_holds(self, name: str) -> str:
        """What a robot said last of the deployment that it cannot decide alone."""
        report = self.robots[name].last
        held_one = ("asking", name, report.candidate if report is not None else "")
        asked = (said for said in reversed(self.said) if (said.answer, said.robot, said.deployment) == held_one)
        return next((said.reason for said in asked if said.reason), "")

    def release(self, name: str, *words: str) -> None:
        """A person aborts what a robot holds, and says so."""
        robot = self.robots[name]
        reason = self.why_it_holds(name)
        held(reason, f"{name} holds without a reason")
        if robot.last is not None:
            self.released.add((name, robot.last.candidate))
        self.field.fame("abort", name, *words)
        self.field.pass_time(2)

    def _hold(self, *problems: str) -> None:
        held(not problems, "; ".join(problems))
