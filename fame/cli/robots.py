"""Commands for running robots: ``fame status``, ``complete``, ``retry``, ``suspend`` and others."""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import (
    Commands,
    Parser,
    add_json,
    add_key,
    add_trust,
    assignment,
    command,
    positive,
    private_key,
    trusted_keys,
)
from fame.cli.network import add_network, connected, note_ready, person, wait_until
from fame.cli.output import print_json, table
from fame.errors import ConfigError, DeploymentError
from fame.text import printable, suggestion

_PROLONG = 1.0
"""Interval in which `fame take-over` asks for its lease again (s); a lease is one of 3 s."""

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.deploy import Report
    from fame.deploy.requests import TaskClient
    from fame.middleware.interface import Middleware, Node


_LISTENING = 1.5  # heartbeats
HEADS = ("robot", "state", "model", "instances", "token at", "since", "waits for", "publishers")


def add_status(commands: Commands) -> None:
    parser = command(
        commands, "status", run_status,
        examples=("fame status", "fame status REX", "fame status --json", "fame status --why REX Event_Order"),
        help="show the state of every robot: model, instances, where its tokens wait, since when, and for what; exit "
        "code 1 if one that is named is silent",
    )  # fmt: skip
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="show these robots only, and wait for them")
    add_trust(
        parser, "show only signed states; engines that prove their names with this key take precedence; repeatable"
    )
    parser.add_argument(
        "--why", nargs="+", metavar=("ROBOT", "ELEMENT"),
        help="explain why each token of a robot waits (or that at ELEMENT, an id or label): the condition and its "
        "values; the topic, its publishers, when its last message came and why the token did not receive it, and what "
        "the robots that publish it wait for, to the end",
    )  # fmt: skip
    add_network(parser)
    add_json(parser)


def run_status(arguments: Namespace) -> int:
    """Listen for a moment, and print the state of each robot."""
    if arguments.why:
        return _explain_waits(arguments)
    from fame.clock import SECOND
    from fame.deploy import engines
    from fame.deploy.fields import values
    from fame.deploy.status import HEARTBEAT
    from fame.version import current as version

    trusted, named = trusted_keys(arguments), set(arguments.robots)
    with connected(arguments) as (scheduler, middleware):
        scheduler.run(scheduler.now + SECOND)
        wait_until(scheduler, lambda: named <= set(engines(middleware)), _PATIENCE if named else 0.0)
        robots = arguments.robots or engines(middleware)
        reports, rivals, strange = subscribe_reports(middleware.node("_fame_status"), robots, trusted)
        scheduler.run(scheduler.now + round(_LISTENING * HEARTBEAT * SECOND))
        wait_until(scheduler, lambda: named <= reports.keys(), _PATIENCE if named else 0.0)
        strange = {**strange, **dict.fromkeys(named - set(engines(middleware)), "no engine of this name was found")}
    silent = silences(reports, robots, _LISTENING * HEARTBEAT)
    if named:
        silent = {name: seconds for name, seconds in silent.items() if name in named}
    if not reports and not silent:
        raise DeploymentError("no engine was found")
    if arguments.json:
        states = {name: values(report) for name, report in sorted(reports.items())}
        print_json({"fame": version(), "robots": states, "silent": silent, "rivals": sorted(rivals)})
    else:
        lines = {name: list(rows(name, report)) for name, report in reports.items()}
        lines |= {
            name: [(name, "silent", "", "", "", f"{s:.0f} s", strange.get(name, ""), "")] for name, s in silent.items()
        }
        for name in rivals:
            text = f"warning: two engines have this name; end fame engine {name} on one computer"
            lines.setdefault(name, []).append(("", "", "", "", "", "", text, ""))
        print(table(HEADS, [row for name in sorted(lines) for row in lines[name]]))
        print(f"\nhere is FAME {version()}; fame doctor compares the robots with it")
    return int(any(name in named for name in silent))


def subscribe_reports(
    node: Node, robots: Iterable[str], trusted: Sequence[Any]
) -> tuple[Mapping[str, Report], Set[str], Mapping[str, str]]:
    """Return the latest report of each robot, the robots with two engines, and why what others say cannot be read: all
    fill as reports come."""
    from fame.deploy import STATUS_QOS, STRING
    from fame.deploy.authentication import ReportReader

    reports: dict[str, Report] = {}
    rivals: set[str] = set()
    strange: dict[str, str] = {}

    def on_message(reader: ReportReader, message: Any) -> None:
        if (report := reader.read(message.data)) is not None:
            reports[reader.robot] = report
        elif reader.strange:
            strange[reader.robot] = reader.strange
        if reader.rival:
            rivals.add(reader.robot)

    for robot in robots:
        reader = ReportReader(robot, signed=bool(trusted), trusted=trusted)
        node.subscription(f"/{robot}/bpmn_status", STRING, partial(on_message, reader), STATUS_QOS)
    return reports, rivals, strange


_PATIENCE = 6.0
"""Time limit for a robot to publish its state (s); it does so twice a second for new subscribers."""


def _explain_waits(arguments: Namespace) -> int:
    """Print why the tokens of a robot wait."""
    from fame.deploy import engines
    from fame.log.live_team import LiveTeam
    from fame.log.wait_chain import WaitChain
    from fame.log.wait_reasons import WaitReason, explain, files_of

    robot, *elements = arguments.why
    if len(elements) > 1:
        raise ConfigError(f"expected --why ROBOT [ELEMENT], got {' '.join(arguments.why)}")
    trusted = trusted_keys(arguments)
    with connected(arguments) as (scheduler, middleware):
        node = middleware.node("_fame_status")
        reports, *_ = subscribe_reports(node, [robot], trusted)
        with LiveTeam(node, middleware, scheduler, lambda *warning: None) as team:

            def known() -> set[str]:
                return team.state.robots.keys() & team.models.keys()

            wait_until(scheduler, lambda: robot in known() or robot in team.foreign, _PATIENCE)
            there = engines(middleware)  # of these, who runs nothing says nothing
            wait_until(scheduler, lambda: known() | team.foreign.keys() >= set(there), _PATIENCE / 3)
            wait_until(scheduler, lambda: robot in reports or robot not in there, _PATIENCE / 3)
            publishers = {info.name: info.publishers for info in middleware.graph()}
    if robot not in there:
        raise DeploymentError(f"unknown robot {robot!r}; {suggestion(robot, there)}")
    if robot in team.foreign:
        raise DeploymentError(team.foreign[robot])
    if robot not in team.state.robots:
        raise DeploymentError(f"{robot} runs no process, or publishes nothing on /{robot}/bpmn_events")
    reasons: list[WaitReason] = explain(
        team.state.robots[robot], team.models.get(robot, {}), elements[0] if elements else "", team.last_time(robot)
    )
    warnings = [*(reports[robot].warnings if robot in reports else ()), *team.foreign.values()]
    chain = WaitChain(
        team.state.robots,
        {name: files_of(model) for name, model in team.models.items()},
        {name: team.last_time(name) for name in team.robots},
        publishers,
    )
    if arguments.json:
        waits = [reason.to_json() | {"chain": list(chain.lines(robot, reason.token))} for reason in reasons]
        print_json({"robot": robot, "waits": waits, "warnings": warnings})
    else:
        lines = ((*reason.lines(robot), *chain.lines(robot, reason.token)) for reason in reasons)
        print("\n".join(line for each in lines for line in each) or f"{robot}: no token waits")
        print(*(f"{robot}: warning: {text}\n" for text in warnings), sep="", end="")
    return 0


def silences(reports: Mapping[str, Report], engines: Iterable[str], listened: float) -> dict[str, float]:
    """Return the robots that publish no status, and for how long at least (s).

    Their engines are in the graph and published nothing for `listened` s, or their team reports them as missing.
    """
    missed = [item for report in reports.values() for item in report.absent.items()]
    silent = dict.fromkeys(engines, listened)
    for robot, seconds in missed:
        silent[robot] = max(seconds, silent.get(robot, 0.0))
    return {robot: seconds for robot, seconds in sorted(silent.items()) if robot not in reports}


def rows(robot: str, report: Report) -> Iterator[tuple[str, ...]]:
    """Yield a line for a robot, and one more for each further token."""
    first, *others = [*_lines(robot, report)] or [("", "", "", "")]
    yield (robot, report.state, report.hash[:12], str(report.instances), *first)
    yield from (("", "", "", "", *line) for line in others)
    for text in report.warnings:
        yield ("", "", "", "", "", "", f"warning: {text}", "")


def _lines(robot: str, report: Report) -> Iterator[tuple[str, str, str, str]]:
    """Place of a token, since when it is there, what it waits for or what is to be said, number of publishers."""
    for wait in report.waits:
        since = f"{max(0.0, report.now - wait.get('since', 0.0)):.0f} s" if report.instances else ""
        counts = ", ".join(str(count) for count in wait.get("topics", {}).values())
        yield wait.get("place") or wait.get("element", ""), since, wait.get("suspended") or wait.get("for", ""), counts
    if report.more_waits:
        yield "", "", f"and {report.more_waits:,} more waiting tokens", ""
    if report.state == "holding":
        ends = f"a newer deployment or fame abort {robot} ends that"
        yield "", "", f"its sender and the others for {report.candidate}; {ends}", ""
    if person := report.suspended:
        steers = f", {person['holder']} steers it" if person.get("holder") else f"; fame continue {robot} ends that"
        since = f"{max(0.0, report.now - person.get('since', 0.0)):.0f} s"
        goals = f"; its goal still runs: {', '.join(report.goals)}" if report.goals else ""
        yield "", since, f"suspended by {person.get('by', '')}{steers}{goals}", ""
    for incident in report.incidents:
        text = f"incident: {incident.get('text', '')}; fame retry {robot} {incident.get('element', '')}"
        yield incident.get("element", ""), "", text, ""
    if report.offers:
        yield "", "", f"fame activate {robot}: {', '.join(report.offers)}", ""
    if error := report.failures or report.error:
        yield "", "", error, ""
    if report.differs:
        yield "", "", report.differs, ""


def add_requests(commands: Commands) -> None:
    _add_for_tasks(commands)
    _add_for_missions(commands)
    _add_for_tokens(commands)


def _add_for_tasks(commands: Commands) -> None:
    """Requests for elements that wait for somebody."""
    completing = _add_request(
        commands, "complete", element="id or label; fame status shows where tokens wait",
        examples=("fame complete REX Task_Inspect", "fame complete REX Task_Release --value approved=true"),
        help="complete a user, manual or receive task of a running robot, with its results",
    )  # fmt: skip
    completing.add_argument(
        "--value", action="append", default=[], type=value, metavar="NAME=VALUE",
        help="a result, which becomes a variable: a number, text, true, false, a list; repeatable",
    )  # fmt: skip
    _add_request(
        commands, "activate", element="id or label; fame status shows which can start",
        examples=("fame activate REX Task_Photo", "fame activate REX Task_Photo --json"),
        help="start an element of an open ad-hoc sub-process of a running robot, again if it has already run",
    )  # fmt: skip


def _add_for_missions(commands: Commands) -> None:
    """Requests for a mission as a whole."""
    aborting = _add_request(
        commands, "abort", examples=("fame abort REX", "fame abort REX --key team.key"),
        help="end an undecided deployment on a robot (fame status: holding); it keeps its old process",
    )  # fmt: skip
    aborting.set_defaults(command=abort)
    _add_request(
        commands, "suspend", examples=("fame suspend REX", "fame suspend REX --key team.key"),
        help="suspend the mission of a running robot, in its safe state, until fame continue",
    )  # fmt: skip
    taking = _add_request(
        commands, "take_over", examples=("fame take-over REX", "fame take-over REX --key team.key"),
        help="suspend the mission of a running robot and let a joystick's node steer it, until Ctrl-C",
    )  # fmt: skip
    taking.set_defaults(command=take_over)
    _add_request(
        commands, "continue", examples=("fame continue REX",),
        help="let a suspended mission continue: activities begin again with their variables",
    )  # fmt: skip
    setting = _add_request(
        commands, "set", examples=("fame set REX speed=0.5", "fame set REX home='[1, 2]' --key team.key"),
        help="set variables of a running robot's mission",
    )  # fmt: skip
    setting.add_argument(
        "value", nargs="+", type=value, metavar="NAME=VALUE", help="a number, text, true, false, a list"
    )


def _add_for_tokens(commands: Commands) -> None:
    """Requests that repair a mission at an element."""
    retrying = _add_request(
        commands, "retry", element="id or label; fame status shows the incidents",
        examples=("fame retry REX Task_Grip", "fame retry REX Task_Grip --set force=12"),
        help="execute a failed element of a running robot again (fame engine --on-error hold)",
    )  # fmt: skip
    retrying.add_argument(
        "--set", action="append", default=[], type=value, dest="value", metavar="NAME=VALUE",
        help="set a variable first; repeatable",
    )  # fmt: skip
    _add_request(
        commands, "skip", element="id or label of where the token waits; it is cancelled",
        examples=("fame skip REX Task_Grip", "fame skip REX Task_Grip --key team.key"),
        help="let a running robot go on behind an element, without its results, by its default flow if it has one",
    )  # fmt: skip
    _add_request(
        commands, "restart", element="id or label of what holds the token, as a call activity; it is cancelled",
        examples=("fame restart REX Task_GoTo",),
        help="execute an element of a running robot again from its beginning",
    )  # fmt: skip
    _add_request(
        commands, "fail", element="id or label of where the token is; it is cancelled",
        examples=("fame fail REX Task_GoTo",),
        help="raise the error taken_over at an element of a suspended robot, whose mission continues",
    )  # fmt: skip
    moving = _add_request(
        commands, "move", element="id or label of where the token waits; it is cancelled", metavar="FROM",
        examples=("fame move REX Task_Grip Task_Ask",),
        help="move a token of a running robot to another element of the same scope",
    )  # fmt: skip
    moving.add_argument("to", metavar="TO", help="id or label of what starts instead")


def _add_request(
    commands: Commands, act: str, *, examples: Sequence[str], help: str, element: str = "", metavar: str = "ELEMENT"
) -> Parser:
    """Declare a command with the arguments that all of them share."""
    parser = command(commands, act.replace("_", "-"), request, examples=examples, help=help)
    parser.set_defaults(act=act, element="", value=[], to="")
    parser.add_argument("robot", metavar="ROBOT")
    if element:
        parser.add_argument("element", metavar=metavar, help=element)
    add_key(parser, "sign the request with this key")
    parser.add_argument("--wait", type=positive, default=5.0, metavar="S", help="how long to wait for the answer (5)")
    add_network(parser)
    add_json(parser)
    return parser


def value(text: str) -> tuple[str, Any]:
    """Return a variable and its value, which JSON has to know."""
    import json

    from fame.engine.data import is_variable

    name, given = assignment(text)
    try:
        json.dumps(given, allow_nan=False)
    except (TypeError, ValueError):
        raise ArgumentTypeError(f"expected a number, text, true, false or a list, got {text!r}") from None
    if not is_variable(name):
        raise ArgumentTypeError(f"expected the name of a variable, got {name!r}")
    return name, given


def request(arguments: Namespace) -> int:
    """Ask a robot to do something (`fame.deploy.requests.TaskRequest`), and print its answer."""
    with connected(arguments) as ends, closing(RobotClient(arguments, *ends)) as robot:
        return _tell(arguments, robot.answer(arguments.act))


def take_over(arguments: Namespace) -> int:
    """Take a robot over and hold that until a signal asks to end, for a node that publishes what it is to do."""
    import uuid

    from fame.robot.suspension import LEASE
    from fame.scenario.process import signals_call

    ended, topic = list[bool](), f"/{arguments.robot}/cmd_vel_manual"
    with (
        connected(arguments) as ends,
        closing(RobotClient(arguments, *ends)) as robot,
        signals_call(lambda *_: ended.append(True)),
    ):
        late = True
        while late and not ended:  # a first answer may take longer than a lease lasts, until all ends are connected
            begun, lease = robot.scheduler.now, uuid.uuid4().hex
            report = robot.answer("take_over", lease)
            late = report.answer != "refused" and robot.scheduler.now - begun > LEASE
        taken = report.answer != "refused"
        code = 0 if taken and arguments.json else _tell(arguments, report)  # JSON is one document, of the end
        if not code:
            note_ready(f"publish geometry_msgs/msg/Twist on {topic}, at least every 0.3 s, to steer it")
        while not code and not wait_until(robot.scheduler, lambda: ended, _PROLONG):
            report = robot.answer("take_over", lease)
            code = _tell(arguments, report) if report.answer == "refused" else 0
        return code or _tell(arguments, robot.answer("suspend"))  # which ends the lease


def _tell(arguments: Namespace, report: Report) -> int:
    """Print the answer of a robot; the exit code."""
    from fame.deploy.requests import STILL_HELD

    done = report.answer not in ("refused", STILL_HELD)
    if arguments.json:
        status = "completed" if done else "failed"
        print_json({"status": status, "robot": arguments.robot, "element": arguments.element, "reason": report.reason})
    else:
        shown = report.reason or arguments.element or ", ".join(dict(arguments.value)) or arguments.robot
        print(f"{arguments.robot}: {report.answer}: {printable(shown)}", flush=True)
    return 0 if done else 1


class RobotClient:
    """Sends requests to the robot that a command names. Raises DeploymentError if no such engine is found."""

    scheduler: WallScheduler

    def __init__(self, arguments: Namespace, scheduler: WallScheduler, middleware: Middleware) -> None:
        from fame.clock import SECOND
        from fame.deploy import engines

        robot, begun = arguments.robot, scheduler.now
        self.scheduler, self._arguments = scheduler, arguments
        self._answers: list[Report] = []
        self._client: TaskClient | None = None
        self._key, self._node = private_key(arguments), middleware.node(f"fame_{arguments.act}")
        if not wait_until(scheduler, lambda: robot in engines(middleware), arguments.wait):
            there = ", ".join(engines(middleware)) or "none"
            raise DeploymentError(f"no engine of a robot named {robot}; there are {there}")
        self._patience = arguments.wait - (scheduler.now - begun) / SECOND

    def answer(self, act: str, lease: str = "") -> Report:
        """Return the answer of the robot. Raises DeploymentError if it does not answer."""
        import os
        import time

        from fame.deploy.requests import TaskClient, TaskRequest

        given, name = self._arguments, f"task-{os.getpid()}-{time.time_ns()}"
        asked = TaskRequest(
            id=name, element=given.element, values=dict(given.value), act=act, to=given.to, lease=lease, who=person()
        )
        self._answers.clear()
        if self._client is None:
            self._client = TaskClient(
                given.robot,
                asked,
                node=self._node,
                scheduler=self.scheduler,
                answered=self._answers.append,
                key=self._key,
            )
        else:
            self._client.ask(asked)
        wait_until(self.scheduler, lambda: self._answers, self._patience)
        self._patience = given.wait
        if not self._answers:
            why = f": {self._client.trouble}" if self._client.trouble else ""
            raise DeploymentError(f"{given.robot} did not answer within {given.wait:g} s{why}")
        return self._answers[0]

    def close(self) -> None:
        if self._client is not None:
            self._client.close()


def abort(arguments: Namespace) -> int:
    """Abort the deployment that the robot holds, and print its answer."""
    with connected(arguments) as (scheduler, middleware):
        answer, reason = _abort(arguments, scheduler, middleware)
    if arguments.json:
        status = "completed" if answer == "aborted" else "failed"
        print_json({"status": status, "robot": arguments.robot, "answer": answer, "reason": reason})
    else:
        shown = reason or ("no deployment is loading or ready there" if answer == "idle" else "it keeps what it had")
        print(f"{arguments.robot}: {answer}: {printable(shown)}")
    return 0 if answer == "aborted" else 1


def _abort(arguments: Namespace, scheduler: WallScheduler, middleware: Middleware) -> tuple[str, str]:
    """Answer and reason. Raises DeploymentError if the robot does not answer."""
    from fame.clock import SECOND
    from fame.deploy.requests import AbortClient

    key = private_key(arguments)
    ended: list[tuple[str, str]] = []
    node = middleware.node("_fame_abort")

    def end(answer: str, reason: str) -> None:
        ended.append((answer, reason))
        scheduler.stop()

    aborting = AbortClient(arguments.robot, node=node, scheduler=scheduler, ended=end, key=key)
    scheduler.run(scheduler.now + round(arguments.wait * SECOND))
    aborting.close()
    if not ended:
        raise DeploymentError(f"{arguments.robot} did not answer within {arguments.wait:g} s")
    return ended[0]
