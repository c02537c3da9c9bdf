"""``fame adm``: the anomaly detection module."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, command

if TYPE_CHECKING:
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware

_EXAMPLES = (
    "fame adm collect --label 1 --runs 30 -o benign.csv",
    "fame adm learn examples/adm_learn.yaml -o best.skops",
    "fame adm operate --model best.skops --threshold 0.01",
)


def add(commands: Commands) -> None:
    """Declare the command and its four parts."""
    from fame.anomaly.cli import add_arguments

    parser = command(
        commands, "adm", run, examples=_EXAMPLES,
        help="learn what a repetitive task looks like, and raise an alarm when a run leaves it",
    )  # fmt: skip
    add_arguments(parser.add_subparsers(metavar="PART", required=True))


def run(arguments: Namespace) -> int:
    """Do it, over DDS unless a bag is read."""
    from fame.anomaly import cli
    from fame.clock import WallScheduler
    from fame.remote import connect

    def join() -> tuple[Middleware, Scheduler]:
        scheduler = WallScheduler()
        return connect("dds", scheduler), scheduler

    return cli.run(arguments, join)
