"""``fame adm operate``: runs evaluated by a learned model as they happen."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.adm.sources import add_published, add_source, drive, say, settle
from fame.cli.arguments import Commands, add_json, command
from fame.cli.network import add_network
from fame.cli.output import print_json
from fame.errors import MissionError

if TYPE_CHECKING:
    from fame.clock import Scheduler
    from fame.middleware.interface import Middleware
    from fame.monitor.anomaly.live import RunReport
    from fame.monitor.anomaly.nodes import OperateNode

_EXAMPLES = (
    "fame adm operate --model best.skops --threshold 0.01",
    "fame adm operate --model best.skops --bag recorded --json",
)


def add(parts: Commands) -> None:
    """Declare the part."""
    parser = command(
        parts, "operate", run, examples=_EXAMPLES, help="score runs with a model, and raise the signal anomaly"
    )
    add_published(parser, "TOPIC MODEL THRESHOLD", {"topic": str, "model": Path, "threshold": float})
    add_source(parser)
    parser.add_argument("--model", type=Path, metavar="MODEL.skops")
    parser.add_argument("--threshold", type=float, metavar="SCORE", help="a run is anomalous above it")
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Judge until all runs are evaluated, the bag is over, or somebody interrupts. 1 if one was anomalous."""
    settle(arguments, "model")
    from fame.monitor.anomaly.model import load_model
    from fame.monitor.anomaly.nodes import OperateNode

    model = load_model(arguments.model)
    nodes: list[OperateNode] = []
    over = False

    def enough() -> bool:
        return bool(nodes) and 0 < arguments.runs <= len(nodes[0].runs)

    def report(text: str) -> None:
        nonlocal over
        if not over:
            say(text)
            over = enough()
            if over:
                nodes[0].scheduler.stop()

    def make(middleware: Middleware, scheduler: Scheduler) -> OperateNode:
        made = OperateNode(
            middleware, scheduler, model, topic=arguments.topic, field=arguments.field,
            threshold=arguments.threshold, rule=arguments.rule, cycle=arguments.points, report=report,
        )  # fmt: skip
        nodes.append(made)
        return made

    drive(arguments, make, enough)
    runs = nodes[0].runs[: arguments.runs or None]
    if not runs and arguments.bag is not None:
        raise MissionError(f"{arguments.bag}: no run was evaluated: none began that the model fits (--rule, --topic)")
    return _tell(runs, arguments.json)


def _tell(runs: Sequence[RunReport], json: bool) -> int:
    above = sum(item.above for item in runs)
    if json:
        names = ("run", "points", "anomalous", "score", "above", "whole")
        told = [{name: getattr(item, name) for name in names} for item in runs]
        print_json({"status": "failed" if above else "completed", "runs": told})
    else:
        cut = sum(not item.whole for item in runs)
        print(f"{len(runs)} runs, {above} of them anomalous" + (f", {cut} cut off" if cut else ""))
    return 1 if above else 0
