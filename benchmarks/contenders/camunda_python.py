"""camunda-python as a contender: in memory, or with SQLite. It has no script tasks: each code is a delegate."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camunda.engine import ProcessEngine
from camunda.parser import parse_bpmn_xml
from camunda.persistence.store import Store
from lxml import etree
from measuring import Prepared, answer

CODE = "{http://camunda.org/schema/1.0/bpmn}delegateExpression"


def delegate(code: str) -> Callable[[dict[str, Any]], None]:
    """What a service task does: its code, on the variables of the process."""
    compiled = compile(code, code, "exec")
    return lambda variables: exec(compiled, {}, variables)


def read(file: str, order: dict[str, Any]) -> Callable[[], Prepared]:
    """The model, parsed; each run has an engine of its own, and its own database if it has one."""
    text = Path(file).read_text()
    model = parse_bpmn_xml(text)
    tasks = etree.fromstring(text).iter("{*}serviceTask")
    delegates = {task.get(CODE)[2:-1]: delegate(task.get("name")) for task in tasks}

    def prepare() -> Prepared:
        folder = tempfile.TemporaryDirectory()
        stored = sys.argv[3:] == ["sqlite"]
        engine = ProcessEngine(Store(f"sqlite:///{folder.name}/state.db")) if stored else ProcessEngine()
        for name, act in delegates.items():
            engine.register_delegate(name, act)
        engine.deploy(model)

        def run() -> dict[str, Any]:
            for _ in range(order["instances"] or 1):
                found = engine.start_process_instance_by_key(order["process"], dict(order["variables"]))
            for _ in range(order["signals"]):
                engine.throw_signal("A")
            if not found.is_completed and not order["signals"]:
                raise SystemExit("stops before its end")
            folder.cleanup()
            return {name: found.variables.get(name) for name in order["variables"]}

        return run

    return prepare


if __name__ == "__main__":
    answer(read)
