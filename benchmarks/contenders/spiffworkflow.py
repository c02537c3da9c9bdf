"""SpiffWorkflow as a contender: its parser, `BpmnWorkflow`, its Python script engine."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lxml import etree
from measuring import Prepared, answer
from SpiffWorkflow.bpmn.parser import BpmnParser
from SpiffWorkflow.bpmn.specs.event_definitions import SignalEventDefinition
from SpiffWorkflow.bpmn.util.event import BpmnEvent
from SpiffWorkflow.bpmn.workflow import BpmnWorkflow


def read(file: str, order: dict[str, Any]) -> Callable[[], Prepared]:
    """The specification, parsed. A called process has to be executable for it."""
    sys.setrecursionlimit(1_000_000)
    parser = BpmnParser()
    text = Path(file).read_text().replace('isExecutable="false"', 'isExecutable="true"')
    parser.add_bpmn_xml(etree.fromstring(text), filename=file)
    spec, called = parser.get_spec(order["process"]), parser.get_subprocess_specs(order["process"])

    def start() -> BpmnWorkflow:
        workflow = BpmnWorkflow(spec, called)
        workflow.task_tree.data.update(order["variables"])
        workflow.do_engine_steps()
        return workflow

    def run() -> dict[str, Any]:
        workflow = start()
        for _ in range(order["instances"] - 1):
            workflow = start()
        for _ in range(order["signals"]):
            workflow.send_event(BpmnEvent(SignalEventDefinition("A")))
            workflow.do_engine_steps()
        if not workflow.is_completed() and not order["signals"]:
            raise SystemExit("stops before its end")
        return {name: workflow.data.get(name) for name in order["variables"]}

    return lambda: run


if __name__ == "__main__":
    answer(read)
