"""Models for the tests of `fame check`, drawn in a line or two, and what is found in them."""

from __future__ import annotations

from pathlib import Path

from bpmn_text import document, process, properties

from fame.bpmn import read_text
from fame.bpmn.library import Library
from fame.check import Finding, check

ROOT = Path(__file__).parent.parent
MODELS = sorted((ROOT / "models").rglob("*.bpmn"))
SIGNALS = "".join(f'<signal id="S_{name}" name="{name}"/>' for name in ("done", "found", "log", "odom"))
ERROR = '<error id="E" name="lost" errorCode="lost"/><error id="E_named" name="spilt"/>' + "".join(
    f'<error id="E_{code}" name="{code}" errorCode="{code}"/>' for code in ("abort", "lost", "script", "unreachabel")
)


def checked(
    text: str, *, strict: bool = False, guidelines: bool = False, library: Library | None = None
) -> list[Finding]:
    """The findings about a file."""
    return check(read_text(text, file="bad.bpmn"), strict=strict, guidelines=guidelines, library=library)


def told(text: str, *levels: str, strict: bool = False, guidelines: bool = False) -> list[str]:
    """What is found in a file: ``element: text``, of these levels, errors and warnings if none is named."""
    found = checked(text, strict=strict, guidelines=guidelines)
    return [f"{one.element}: {one.text}" for one in found if one.level in (levels or ("error", "warning"))]


def flow(source: str, target: str, condition: str = "") -> str:
    """A sequence flow, its id made of those of its ends."""
    inside = f"<conditionExpression>{condition}</conditionExpression>" if condition else ""
    return f'<sequenceFlow id="{source}-{target}" sourceRef="{source}" targetRef="{target}">{inside}</sequenceFlow>\n'


def flows(*chains: str) -> str:
    """Sequence flows through elements in a row: ``"s a b e"``."""
    pairs = [pair for chain in chains for pair in zip(chain.split(), chain.split()[1:], strict=False)]
    return "".join(flow(source, target) for source, target in pairs)


def row(*elements: str, mark: str = "") -> str:
    """A start ``s``, the elements, and an end ``e``, one after the other. `mark` makes other ids of these."""
    ids = [element.partition('id="')[2].partition('"')[0] for element in elements]
    drawn = "\n".join([f'<startEvent id="s{mark}"/>', *elements, f'<endEvent id="e{mark}"/>'])
    return f"{drawn}\n{flows(' '.join([f's{mark}', *ids, f'e{mark}']))}"


def script(text: str, id: str = "t", format: str = "python") -> str:
    """A script task."""
    return f'<scriptTask id="{id}" scriptFormat="{format}"><script>{text}</script></scriptTask>'


def event(tag: str, id: str, signal: str, inside: str = "", after: str = "") -> str:
    """A signal event."""
    return f'<{tag} id="{id}" name="{signal}">{inside}<signalEventDefinition signalRef="S_{signal}"/>{after}</{tag}>'


def throw(id: str, signal: str = "done", **said: str) -> str:
    """An intermediate throw."""
    return event("intermediateThrowEvent", id, signal, properties(**said))


def catch(id: str, signal: str = "done", into: str = "", **said: str) -> str:
    """An intermediate catch; `into` is the data object that it fills."""
    output = f'<dataOutputAssociation id="{id}-{into}"><targetRef>{into}</targetRef></dataOutputAssociation>'
    inside = properties(**said) + (output if into else "")
    return event("intermediateCatchEvent", id, signal, inside)


def data(id: str, **values: str) -> str:
    """A data object with its variables."""
    inside = properties(**values)
    return f'<dataObjectReference id="{id}" name="{id}" dataObjectRef="{id}_o">{inside}</dataObjectReference>'


def reading(id: str, object: str, text: str = "pass") -> str:
    """A script task with an input association."""
    return f'<scriptTask id="{id}">{given(id, object)}<script>{text}</script></scriptTask>'


def given(id: str, object: str) -> str:
    """The association that gives a data object to an element."""
    return (
        f'<property id="{id}_p" name="__targetRef_placeholder"/><dataInputAssociation id="{id}-{object}">'
        f"<sourceRef>{object}</sourceRef><targetRef>{id}_p</targetRef></dataInputAssociation>"
    )


def filling(id: str, object: str, text: str) -> str:
    """A script task with an output association."""
    output = f'<dataOutputAssociation id="{id}-{object}"><targetRef>{object}</targetRef></dataOutputAssociation>'
    return f'<scriptTask id="{id}">{output}<script>{text}</script></scriptTask>'


def service(**said: str) -> str:
    """A service task."""
    return f'<serviceTask id="t">{properties(**said)}</serviceTask>'


def timer(tag: str, kind: str, text: str, attributes: str = "") -> str:
    """A timer event ``w``."""
    inside = f"<timerEventDefinition><{kind}>{text}</{kind}></timerEventDefinition>"
    return f'<{tag} id="w" {attributes}>{inside}</{tag}>'


def caught_at(activity: str, code: str) -> str:
    """An error boundary event ``b``, and an end ``be``."""
    inside = f'<errorEventDefinition errorRef="E_{code}"/>'
    return f'<boundaryEvent id="b" attachedToRef="{activity}">{inside}</boundaryEvent>{ends("be")}{flow("b", "be")}'


def alone(content: str) -> str:
    """A file with one process and no pool."""
    return process(content, SIGNALS + ERROR)


def team(*contents: str, pools: str = "") -> str:
    """A collaboration: pools REX, DINGO ... with processes P1, P2 ..."""
    names = ("REX", "DINGO", "DRONE")
    drawn = "".join(
        f'<participant id="Pool{n}" name="{names[n - 1]}" processRef="P{n}"/>' for n in range(1, len(contents) + 1)
    )
    bodies = "".join(f'<process id="P{n}">\n{content}\n</process>\n' for n, content in enumerate(contents, 1))
    return document(f'<collaboration id="C">{drawn}{pools}</collaboration>\n{bodies}{SIGNALS}{ERROR}')


def choice(id: str, attributes: str = "") -> str:
    """An exclusive gateway."""
    return f'<exclusiveGateway id="{id}" {attributes}/>'


def parallel(id: str) -> str:
    """A parallel gateway."""
    return f'<parallelGateway id="{id}"/>'


def ends(*ids: str) -> str:
    """None end events."""
    return "".join(f'<endEvent id="{id}"/>' for id in ids)


def call(id: str, called: str, inside: str = "") -> str:
    """A call activity."""
    return f'<callActivity id="{id}" calledElement="{called}">{inside}</callActivity>'


VECTOR, BOOL = "geometry_msgs/msg/Vector3", "std_msgs/msg/Bool"
START = '<startEvent id="s"/>'
