"""``fame complete``: somebody did what a task of a running robot waits for."""

from __future__ import annotations

from argparse import ArgumentTypeError, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_json, command, positive
from fame.cli.network import add_network, connected
from fame.cli.output import print_json
from fame.text import printable

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.deploy import Report
    from fame.middleware.interface import Middleware


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "complete", run,
        examples=("fame complete REX Task_Inspect", "fame complete REX Task_Release --value approved=true"),
        help="tell a running robot that a user, manual or receive task is done, with its results",
    )  # fmt: skip
    parser.add_argument("robot", metavar="ROBOT")
    parser.add_argument("element", metavar="ELEMENT", help="the id of the task; fame status shows where tokens wait")
    parser.add_argument(
        "--value", action="append", default=[], type=value, metavar="NAME=VALUE",
        help="a result, which becomes a variable: a number, text, true, false, a list; repeatable",
    )  # fmt: skip
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="sign it with this key (see fame keys)")
    parser.add_argument("--wait", type=positive, default=5.0, metavar="S", help="how long to wait for the answer (5)")
    add_network(parser)
    add_json(parser)


def value(text: str) -> tuple[str, Any]:
    """A variable and its value, which JSON has to know."""
    import json

    from fame.cli.process import assignment
    from fame.engine.data import is_variable

    name, given = assignment(text)
    try:
        json.dumps(given, allow_nan=False)
    except (TypeError, ValueError):
        raise ArgumentTypeError(f"found {text!r}, a number, text, true, false, or a list would be right") from None
    if not is_variable(name):
        raise ArgumentTypeError(f"found {name!r}, the name of a variable would be right")
    return name, given


def run(arguments: Namespace) -> int:
    """Tell the robot, and say how it answered."""
    return ask_and_tell(arguments, "complete", dict(arguments.value))


def ask_and_tell(arguments: Namespace, act: str, values: Mapping[str, Any]) -> int:
    """Ask a robot to do something (`fame.deploy.requests.TaskRequest`), and print its answer."""
    with connected(arguments) as (scheduler, middleware):
        report = _ask(arguments, act, values, scheduler, middleware)
    done = report.answer != "refused"
    if arguments.json:
        print_json(
            {
                "status": "completed" if done else "failed",
                "robot": arguments.robot,
                "element": arguments.element,
                "reason": report.reason,
            }
        )
    else:
        print(f"{arguments.robot}: {report.answer}: {printable(report.reason or arguments.element)}")
    return 0 if done else 1


def _ask(
    arguments: Namespace, act: str, values: Mapping[str, Any], scheduler: WallScheduler, middleware: Middleware
) -> Report:
    """The robot's answer. Raises DeploymentError if there is none."""
    import os
    import time

    from fame.clock import SECOND
    from fame.deploy import Report, engines
    from fame.deploy.requests import TaskClient, TaskRequest
    from fame.deploy.signing import read_private
    from fame.errors import DeploymentError

    key = read_private(arguments.key) if arguments.key is not None else None
    robot, answers = arguments.robot, list[Report]()
    until = scheduler.now + round(arguments.wait * SECOND)
    while robot not in engines(middleware):
        if scheduler.now >= until:
            there = ", ".join(engines(middleware)) or "none"
            raise DeploymentError(f"no engine of a robot named {robot}; there are {there}")
        scheduler.run(scheduler.now + SECOND // 20)
    done = TaskRequest(id=f"task-{os.getpid()}-{time.time_ns()}", element=arguments.element, values=values, act=act)
    asking = TaskClient(
        robot, done, node=middleware.node(f"fame_{act}"), scheduler=scheduler, answered=answers.append, key=key
    )
    while not answers and scheduler.now < until:
        scheduler.run(scheduler.now + SECOND // 50)
    asking.close()
    if not answers:
        raise DeploymentError(f"{robot} did not answer within {arguments.wait:g} s")
    return answers[0]
