"""Small models for the tests of the engine, and their runs.

Elements are written with the functions here, named after what they make; a model is a text of them and of paths
(``path("s a b e")``), read by `fame.bpmn` like any file. `Run` drives one with `fame.Simulation`; `Run.log` is what an
observer was told, in order, as words:

===========  =============================================================
``a``        a token came to element a, which completed at once
``(a``       a token came to a
``a)``       a has completed
``-a``       a, or what went on in it, was cancelled
``a!code``   a failed with that code
``=status``  the instance ended
===========  =============================================================
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import fame
from fame.bpmn import read_text
from fame.bpmn.model import Definitions
from fame.engine import Instance, restore, snapshot
from fame.robot import Event
from fame.robot.state_tables import StateTables, fold, restore_engine
from fame.robot.stored_values import dump

HEAD = (
    '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'
    ' xmlns:zeebe="http://camunda.org/schema/zeebe/1.0"'
    ' id="D" targetNamespace="http://fame">'
)
_REFERENCES = {"signal": "name", "message": "name", "error": "errorCode", "escalation": "escalationCode"}

# ---- elements ----------------------------------------------------------------------------------------------------


def element(tag: str, id: str, *content: str, **attributes: str) -> str:
    """Any element."""
    said = "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items())
    return f'<{tag} id="{id}"{said}>{"".join(content)}</{tag}>'


def start(id: str = "s", *content: str, interrupting: bool = True) -> str:
    """A start event."""
    return element("startEvent", id, *content, isInterrupting=str(interrupting).lower())


def end(id: str = "e", *content: str) -> str:
    """An end event."""
    return element("endEvent", id, *content)


def catch(id: str, *content: str, **attributes: str) -> str:
    """An intermediate catching event."""
    return element("intermediateCatchEvent", id, *content, **attributes)


def throw(id: str, *content: str) -> str:
    """An intermediate throwing event."""
    return element("intermediateThrowEvent", id, *content)


def boundary(id: str, activity: str, *content: str, interrupting: bool = True, **attributes: str) -> str:
    """A boundary event."""
    cancels = str(interrupting).lower()
    return element("boundaryEvent", id, *content, attachedToRef=activity, cancelActivity=cancels, **attributes)


def script(id: str, text: str = "pass", *content: str) -> str:
    """A script task."""
    return element("scriptTask", id, *content, f"<script>{escape(text)}</script>", scriptFormat="python")


def user(id: str, *content: str) -> str:
    """A user task."""
    return element("userTask", id, *content)


def sub(id: str, *content: str, **attributes: str) -> str:
    """A sub-process."""
    return element("subProcess", id, *content, **attributes)


def handler(id: str, *content: str, resume: bool = False) -> str:
    """An event sub-process."""
    return sub(id, *([properties(resume="true")] if resume else []), *content, triggeredByEvent="true")


def call(id: str, called: str, *content: str) -> str:
    """A call activity."""
    return element("callActivity", id, *content, calledElement=called)


def gateway(kind: str, id: str, *content: str, **attributes: str) -> str:
    """A gateway: exclusive, parallel, inclusive, eventBased, complex."""
    return element(f"{kind}Gateway", id, *content, **attributes)


def path(ids: str) -> str:
    """Sequence flows along some ids: ``a_b`` from a to b."""
    names = ids.split()
    return "".join(flow(source, target) for source, target in pairwise(names))


def flow(source: str, target: str, condition: str = "") -> str:
    """A sequence flow, perhaps with a condition."""
    said = f"<conditionExpression>{escape(condition)}</conditionExpression>" if condition else ""
    return element("sequenceFlow", f"{source}_{target}", said, sourceRef=source, targetRef=target)


# ---- inside elements ---------------------------------------------------------------------------------------------


def signal(name: str) -> str:
    """A signal event definition."""
    return f'<signalEventDefinition signalRef="signal_{name}"/>'


def message(name: str) -> str:
    """A message event definition."""
    return f'<messageEventDefinition messageRef="message_{name}"/>'


def error(code: str = "") -> str:
    """An error event definition."""
    return f'<errorEventDefinition errorRef="error_{code}"/>' if code else "<errorEventDefinition/>"


def escalation(code: str = "") -> str:
    """An escalation event definition."""
    return f'<escalationEventDefinition escalationRef="escalation_{code}"/>' if code else "<escalationEventDefinition/>"


def timer(text: str, kind: str = "Duration") -> str:
    """A timer event definition."""
    return f"<timerEventDefinition><time{kind}>{escape(text)}</time{kind}></timerEventDefinition>"


def condition(text: str) -> str:
    """A conditional event definition."""
    return f"<conditionalEventDefinition><condition>{escape(text)}</condition></conditionalEventDefinition>"


def link(name: str) -> str:
    """A link event definition."""
    return f'<linkEventDefinition name="{name}"/>'


def correlation(path: str, *messages: str, name: str = "key") -> str:
    """A correlation property, for the root of a file, which these messages have at a path of ``msg``."""
    retrieve = "".join(
        f'<correlationPropertyRetrievalExpression messageRef="message_{one}"><messagePath>{path}</messagePath>'
        "</correlationPropertyRetrievalExpression>"
        for one in messages
    )
    return f'<correlationProperty id="K" name="{name}">{retrieve}</correlationProperty>'


TERMINATE = "<terminateEventDefinition/>"
CANCEL = "<cancelEventDefinition/>"


def extensions(content: str) -> str:
    """Extension elements."""
    return f"<extensionElements>{content}</extensionElements>"


def properties(**named: Any) -> str:
    """Extension properties: type, payload, queue, resume."""
    said = "".join(f"<camunda:property name={quoteattr(n)} value={quoteattr(str(v))}/>" for n, v in named.items())
    return extensions(f"<camunda:properties>{said}</camunda:properties>")


def process(*content: str, id: str = "P", **properties_of: Any) -> str:
    """A process; further arguments are its properties."""
    said = properties(**properties_of) if properties_of else ""
    return f'<process id="{id}" isExecutable="{str(id == "P").lower()}">{said}{"".join(content)}</process>'


@lru_cache(maxsize=16)
def model(*processes: str, root: str = "") -> Definitions:
    """A file of processes, with the signals, messages, errors and escalations that they refer to.

    Read once for the runs of a test, which share its program.
    """
    text = "".join(item if item.startswith("<process") else process(item) for item in processes)
    for kind, attribute in _REFERENCES.items():
        for name in dict.fromkeys(re.findall(rf'{kind}Ref="{kind}_(\w+)"', text)):
            root += f'<{kind} id="{kind}_{name}" {attribute}="{name}"/>'
    return read_text(f"{HEAD}{root}{text}</definitions>", file="test.bpmn")


# ---- runs --------------------------------------------------------------------------------------------------------


class Run:
    """A run of a model.

    `after` every stimulus the engine is ``restored``, made anew from its snapshot; or its changes are ``recorded``, and
    all changes so far give its state. Else it runs ``straight``.
    """

    def __init__(
        self,
        definitions: Definitions | str,
        variables: Mapping[str, Any] | None = None,
        *,
        after: str = "straight",
        moves: int | None = None,
        **options: Any,
    ) -> None:
        if isinstance(definitions, str):
            definitions = model(definitions)
        self.events: list[Event] = []
        self.state: tuple[Any, str] = (None, "null")  # what the engine was restored from last, as data and as text
        self.simulation = fame.Simulation(definitions, "P", variables, observer=self.events.append, **options)
        self.node = self.simulation.node
        if moves is not None:
            self.node.engine.limit = moves
        self.tables, self.recorded = StateTables(self.node.engine, lambda name, reason: None, dump), {}
        if after != "straight":
            self._after_each(self.swap if after == "restored" else self.record)

    def _after_each(self, check: Callable[[], object]) -> None:
        scheduler, at = self.simulation.scheduler, self.simulation.scheduler.at

        def followed(action: Callable[[], object]) -> Callable[[], object]:
            return lambda: (action(), check())

        def at_and_swap(time: int, action: Callable[[], object], *rest: Any) -> Any:
            return at(time, followed(action), *rest)

        scheduler.at = at_and_swap  # type: ignore[method-assign]
        for name in ("deliver", "complete", "start", "activate"):
            self._check_after(name, check)

    def _check_after(self, name: str, check: Callable[[], object]) -> None:
        method = getattr(self.node, name)

        def followed(*arguments: Any) -> None:
            method(*arguments)
            check()

        setattr(self.node, name, followed)

    def record(self) -> None:
        """Record what has changed. All changes so far have to give the same state."""
        engine = self.node.engine
        fold(self.recorded, json.loads(json.dumps(self.tables.changes({}))))
        if engine.cancelling:
            return  # what goes on when scripts have left is under way in a restored engine
        text = json.dumps(self.recorded)
        again = restore_engine(self.recorded, engine.program, self.node.host, engine.new_variables, load)
        assert snapshot(again, dump=dump) == snapshot(engine, dump=dump)
        assert json.dumps(self.recorded) == text

    def swap(self) -> None:
        """Make the engine anew from its snapshot, unless a script is under way, which is no data."""
        engine = self.node.engine
        if engine.cancelling or any(wait.started for wait in engine.waits.values()):
            return
        assert json.dumps(self.state[0]) == self.state[1], "the engine has changed what it was restored from"
        text = json.dumps(snapshot(engine, dump=dump))
        self.state = json.loads(text), text
        fresh = restore(engine.program, self.state[0], self.node.host, engine.new_variables, load=load)
        fresh.limit = engine.limit
        assert json.dumps(snapshot(fresh, dump=dump)) == text
        self.node.attach(fresh)

    # ---- stimuli

    def run(self, until: float | None = None) -> Run:
        """Run until nothing can move, or until simulated second `until`."""
        self.simulation.run(until)
        return self

    def signal(self, name: str, payload: Any = None) -> Run:
        """A message on a topic."""
        self.simulation.signal(name, payload)
        return self

    message = signal

    def complete(self, id: str, values: Mapping[str, Any] | None = None) -> Run:
        """Somebody completes a task."""
        self.simulation.complete(id, values)
        return self

    def activate(self, id: str) -> Run:
        """Somebody lets an element of an ad-hoc sub-process begin."""
        self.simulation.activate(id)
        return self

    def at(self, second: float) -> Run:
        """Let time go on to this simulated second."""
        return self.run(second)

    # ---- what came of it

    @property
    def instance(self) -> Instance:
        """The only instance."""
        (found,) = self.simulation.instances
        return found

    @property
    def status(self) -> str:
        return self.instance.status

    @property
    def waiting(self) -> list[str]:
        return list(self.instance.waiting)

    @property
    def variables(self) -> dict[str, Any]:
        return self.instance.variables

    @property
    def log(self) -> str:
        """What happened so far, in words."""
        return " ".join(words([event for event in self.events if event.what in _MARKS]))

    @property
    def visits(self) -> dict[str, int]:
        return dict(self.instance.visits)

    @property
    def reports(self) -> list[str]:
        return [str(event.detail) for event in self.simulation.reports if event.what == "report"]

    def left_behind(self) -> dict[str, int]:
        """Sizes of the engine's tables that are not empty."""
        engine = self.node.engine
        names = ("ready", "listeners", "conditions", "waits", "inclusive", "cancelling", "instances",
                 "waiting_starts")  # fmt: skip
        return {name: len(getattr(engine, name)) for name in names if getattr(engine, name)}


_MARKS = {"enter": "({}", "leave": "{})", "cancel": "-{}", "fail": "{}!{}", "end": "={1}"}


def words(events: list[Event]) -> list[str]:
    """The notation of `Run.log`."""
    found: list[str] = []
    for event in events:
        if event.what == "leave" and found and found[-1] == f"({event.element}":
            found[-1] = event.element
        else:
            found.append(_MARKS[event.what].format(event.element, event.detail))
    return found


def load(data: Any) -> Any:
    """The value again, of what `dump` made of it."""
    from fame.middleware import messages

    return messages.create(data["message"], data["value"])
