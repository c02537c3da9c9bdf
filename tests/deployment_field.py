"""A field of robots for the tests of deployment: engines, a sender, and what is said between them."""

import json
from collections.abc import Sequence
from dataclasses import replace

from fame import deploy
from fame.bpmn.reader import read_text
from fame.clock import SECOND, Scheduler
from fame.deploy import Deployment, EngineNode, Report
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"


def process(id: str, content: str, *flows: tuple[str, str]) -> str:
    arrows = "".join(
        f'<sequenceFlow id="{id}f{n}" sourceRef="{source}" targetRef="{target}"/>'
        for n, (source, target) in enumerate(flows)
    )
    return f'<process id="{id}" isExecutable="true">{content}{arrows}</process>'


def definitions(*content: str) -> str:
    return f'<definitions xmlns="{BPMN}" targetNamespace="t">{"".join(content)}</definitions>'


def patrol(mark: int) -> str:
    """A process that sets `mark` and then waits for a signal forever."""
    return definitions(
        '<signal id="S" name="stop"/>',
        process(
            "p",
            f'<startEvent id="s"/><scriptTask id="t"><script>mark = {mark}</script></scriptTask>'
            '<intermediateCatchEvent id="c"><signalEventDefinition signalRef="S"/></intermediateCatchEvent>',
            ("s", "t"),
            ("t", "c"),
        ),
    )


LATE = "<timerEventDefinition><timeDuration>5s</timeDuration></timerEventDefinition>"
TEAM = definitions(
    '<signal id="S" name="go"/><collaboration id="c"><participant id="A" name="A" processRef="pa"/>'
    '<participant id="B" name="B" processRef="pb"/></collaboration>',
    process(
        "pa",
        '<startEvent id="sa"/><intermediateThrowEvent id="throw"><signalEventDefinition signalRef="S"/>'
        '</intermediateThrowEvent><userTask id="ua"/>',
        ("sa", "throw"),
        ("throw", "ua"),
    ),
    process(
        "pb",
        '<startEvent id="sb"><signalEventDefinition signalRef="S"/></startEvent><userTask id="ub"/>',
        ("sb", "ub"),
    ),
)


ERROR = '<errorEventDefinition errorRef="E"/>'
"""Ends a process of `job` in an error."""


def timer(id: str, seconds: float) -> str:
    duration = f"<timerEventDefinition><timeDuration>PT{seconds}S</timeDuration></timerEventDefinition>"
    return f'<intermediateCatchEvent id="{id}">{duration}</intermediateCatchEvent>'


def job(waits: int, works: float, end: str = "") -> str:
    """B has run once; A waits (s), ends, and starts B again, which works (s) and ends, perhaps in `ERROR`."""
    return definitions(
        '<signal id="S" name="job"/><error id="E" errorCode="broken"/><collaboration id="c">'
        '<participant id="A" name="A" processRef="pa"/><participant id="B" name="B" processRef="pb"/></collaboration>',
        process(
            "pa",
            f'<startEvent id="sa"/>{timer("t", waits)}'
            '<endEvent id="ea"><signalEventDefinition signalRef="S"/></endEvent>',
            ("sa", "t"),
            ("t", "ea"),
        ),
        process(
            "pb",
            '<startEvent id="sb"/><endEvent id="eb"/>'
            '<startEvent id="job"><signalEventDefinition signalRef="S"/></startEvent>'
            f'{timer("work", works)}<endEvent id="cut">{end}</endEvent>',
            ("sb", "eb"),
            ("job", "work"),
            ("work", "cut"),
        ),
    )


class Field:
    """Robots with engines, a plain publisher, and all that the robots have said."""

    def __init__(self, *robots: str, scheduler: Scheduler | None = None, **options) -> None:
        self.scheduler = Scheduler() if scheduler is None else scheduler  # one with nothing to do is false
        self.middleware = LocalMiddleware(self.scheduler)
        self.engines: dict[str, EngineNode] = {}
        for name in robots:
            self.add(name, **options)
        self.listen(*robots)

    def add(self, name: str, **options) -> EngineNode:
        """Start an engine with these `EngineOptions`; it is what is meant by its name from now on."""
        self.engines[name] = EngineNode(
            name, scheduler=self.scheduler, middleware=self.middleware, options=EngineOptions(**options)
        )
        return self.engines[name]

    def listen(self, *robots: str) -> None:
        self.person = self.middleware.node("person")
        self.publishers = {name: self.person.publisher(f"/{name}/bpmn_process", deploy.STRING) for name in robots}
        self.said: list[Report] = []
        for name in robots:
            self.person.subscription(f"/{name}/bpmn_status", deploy.STRING, self._hear, deploy.STATUS_QOS)

    def _hear(self, message) -> None:
        self.said.append(Report(**json.loads(message.data)))

    def send(self, robot: str, text: str) -> None:
        self.publishers[robot].publish(messages.create(deploy.STRING, text))

    def pass_time(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    def prepare(
        self,
        text: str,
        id: str = "d1",
        sequence: int = 1,
        options: DeploymentOptions | None = None,
        **more,
    ) -> Deployment:
        """A deployment that has not begun."""
        return Deployment(
            read_text(text, file="team.bpmn"),
            id=id,
            sequence=sequence,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=lambda deployment: None,
            options=replace(options or DeploymentOptions(), **more),
        )

    def deploy(self, text: str, id: str = "d1", sequence: int = 1, **options) -> Deployment:
        sent = self.prepare(text, id, sequence, **options)
        sent.begin()
        self.pass_time(12)
        return sent

    def answers(self) -> list[str]:
        return [report.answer for report in self.said if report.answer]

    def variables(self, robot: str) -> dict:
        return self.engines[robot].running.instances[-1].variables


def kill(deployment: Deployment) -> None:
    """Let nothing happen at a sender's end any more."""
    deployment._protocol.state = replace(deployment._protocol.state, phase="over")
    for entry in (deployment._limit, deployment._timer):
        entry.cancel()


def made(field: Field, text: str, id: str, sequence: int, robots: Sequence[str] = ("A", "B"), **options) -> Deployment:
    """A deployment to these robots that has not begun."""
    return field.prepare(text, id, sequence, robots=list(robots), **options)
