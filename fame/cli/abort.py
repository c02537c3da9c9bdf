"""``fame abort``: end a deployment that a robot holds, since it hears neither its sender nor the other robots."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command, positive
from fame.cli.network import add_network, connected
from fame.cli.output import print_json
from fame.text import printable

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.middleware.interface import Middleware


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "abort", run, examples=("fame abort REX", "fame abort REX --key team.key"),
        help="abort the deployment that a robot holds (fame status: holding); it keeps the process that it had",
    )  # fmt: skip
    parser.add_argument("robot", metavar="ROBOT")
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="sign it with this key (see fame keys)")
    parser.add_argument("--wait", type=positive, default=5.0, metavar="S", help="how long to wait for the answer (5)")
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Tell the robot, and say how it answered."""
    with connected(arguments) as (scheduler, middleware):
        answer, reason = _abort(arguments, scheduler, middleware)
    if arguments.json:
        status = "completed" if answer == "aborted" else "failed"
        print_json({"status": status, "robot": arguments.robot, "answer": answer, "reason": reason})
    else:
        said = reason or ("no deployment is loading or ready there" if answer == "idle" else "it keeps what it had")
        print(f"{arguments.robot}: {answer}: {printable(said)}")
    return 0 if answer == "aborted" else 1


def _abort(arguments: Namespace, scheduler: WallScheduler, middleware: Middleware) -> tuple[str, str]:
    """Answer and reason. Raises DeploymentError if the robot does not answer."""
    from fame.clock import SECOND
    from fame.deploy.requests import AbortClient
    from fame.deploy.signing import read_private
    from fame.errors import DeploymentError

    key = read_private(arguments.key) if arguments.key is not None else None
    ended: list[tuple[str, str]] = []
    node = middleware.node("fame_abort")

    def end(answer: str, reason: str) -> None:
        ended.append((answer, reason))
        scheduler.stop()

    aborting = AbortClient(arguments.robot, node=node, scheduler=scheduler, ended=end, key=key)
    scheduler.run(scheduler.now + round(arguments.wait * SECOND))
    aborting.close()
    if not ended:
        raise DeploymentError(f"{arguments.robot} did not answer within {arguments.wait:g} s")
    return ended[0]
