"""The small missions that teams run: three robots, at most ten elements, one version after the other."""

from __future__ import annotations

import re
from functools import lru_cache

from fame.bpmn.model import Definitions
from fame.bpmn.reader import read_text

_BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
_CAMUNDA = "http://camunda.org/schema/1.0/bpmn"
ROBOTS = ("A", "B", "C")


def _process(id: str, elements: str, *flows: str) -> str:
    pairs = (flow.split(">") for flow in flows)
    arrows = "".join(f'<sequenceFlow id="{id}{n}" sourceRef="{a}" targetRef="{b}"/>' for n, (a, b) in enumerate(pairs))
    return f'<process id="{id}" isExecutable="true">{elements}{arrows}</process>'


def _signal(tag: str, id: str, properties: str = "", signal: str = "tick") -> str:
    more = f"<extensionElements><camunda:properties>{properties}</camunda:properties></extensionElements>"
    return f'<{tag} id="{id}">{more}<signalEventDefinition signalRef="{signal}"/></{tag}>'


def _listening(id: str, version: int, *, breaks: bool, watched: bool) -> str:
    work = BREAKS if breaks else "pass"
    alarmed, begun, flows = "", "", ()
    if watched:
        begun = "; alarms = []"
        alarmed = _signal("intermediateCatchEvent", f"{id}watch", _ALARM, "alarm") + (
            f'<scriptTask id="{id}note"><script>alarms = alarms + [round(alarm)]</script></scriptTask>'
        )
        flows = f"{id}init>{id}watch", f"{id}watch>{id}note", f"{id}note>{id}watch"
    return _process(
        id,
        f'<startEvent id="{id}s"/><scriptTask id="{id}init"><script>version, kept, mended = {version}, [], 0'
        f"{begun}</script></scriptTask>"
        + _signal("intermediateCatchEvent", f"{id}hear", '<camunda:property name="queue" value="50"/>')
        + f'<scriptTask id="{id}work"><script>{work}</script></scriptTask>'
        + f'<scriptTask id="{id}keep"><script>kept = kept + [tick]</script></scriptTask>{alarmed}',
        f"{id}s>{id}init", f"{id}init>{id}hear", f"{id}hear>{id}work", f"{id}work>{id}keep", f"{id}keep>{id}hear",
        *flows,
    )  # fmt: skip


def _counting(version: int, payload: str, *, drives: bool, works: bool) -> str:
    task, flows, first = "", ("count>say",), ("begin>pause",)
    if drives:
        task, flows = _DRIVE, ("count>go", "go>say", "gone>say")
    if works:
        task, first = task + _WORK, ("begin>both", "both>pause", "both>work")
    return _process(
        "pa",
        f'<startEvent id="sa"/><scriptTask id="begin"><script>n = {1000 * version}</script></scriptTask>'
        '<intermediateCatchEvent id="pause"><timerEventDefinition><timeDuration>PT0.7S</timeDuration>'
        "</timerEventDefinition></intermediateCatchEvent>"
        '<scriptTask id="count"><script>n = n + 1</script></scriptTask>'
        + task
        + _signal("intermediateThrowEvent", "say", payload),
        "sa>begin", *first, "pause>count", *flows, "say>pause",
    )  # fmt: skip


BREAKS = "if tick % 10 == 3 and not mended: raise ValueError('broken')\nmended = 0"
"""What C does with a count: now and then it fails, until a person has mended it."""
_ALARM = '<camunda:property name="type" value="std_msgs/msg/Float64"/><camunda:property name="queue" value="50"/>'
DRIVE = "nav2_msgs/action/NavigateToPose"
_DRIVE = (
    '<serviceTask id="go"><extensionElements><camunda:properties><camunda:property name="action" value="/go"/>'
    f'<camunda:property name="type" value="{DRIVE}"/><camunda:property name="retry" value="safe"/>'
    '<camunda:property name="payload" value="{pose: {pose: {position: {x: ${n}}}}}"/></camunda:properties>'
    '</extensionElements></serviceTask><boundaryEvent id="gone" attachedToRef="go"><errorEventDefinition/>'
    "</boundaryEvent>"
)
WORK = "/work"
_WORK = (
    '<parallelGateway id="both"/><scriptTask id="work"><script>for copy in [robot.random.randrange(10**9)] * 999:\n'
    f'    robot.publish("{WORK}", "std_msgs/msg/Int32", {{"data": copy}})\n    await sleep(0.5)</script></scriptTask>'
)
"""What goes on beside the counts: each copy of it publishes a number of its own, whatever else sets the variable."""


def text(version: int, more: str = "") -> str:
    """A counts, and says its count on `/tick`; the others keep the counts that they receive.

    `more`: with ``drives`` A has a goal for each count; with ``breaks`` C needs somebody now and then; with
    ``acknowledges`` each count is acknowledged within 5 s; with ``watched`` B keeps the alarms of `monitor.yaml`; with
    ``works`` a script of A publishes on `WORK` all the time.
    """
    payload = (
        '<camunda:property name="type" value="std_msgs/msg/Int32"/><camunda:property name="payload" value="${n}"/>'
    )
    if "acknowledges" in more:
        payload += '<camunda:property name="delivery" value="acknowledged"/><camunda:property name="ttl" value="5"/>'
    counting = _counting(version, payload, drives="drives" in more, works="works" in more)
    listening = "".join(
        _listening(
            f"p{name.lower()}",
            version,
            breaks=name == "C" and "breaks" in more,
            watched=name == "B" and "watched" in more,
        )
        for name in ROBOTS[1:]
    )
    alarm = '<signal id="alarm" name="alarm"/>' if "watched" in more else ""
    pools = "".join(f'<participant id="P{name}" name="{name}" processRef="p{name.lower()}"/>' for name in ROBOTS)
    return (
        f'<definitions xmlns="{_BPMN}" xmlns:camunda="{_CAMUNDA}" targetNamespace="t">'
        f'<signal id="tick" name="tick"/>{alarm}'
        f'<collaboration id="c">{pools}</collaboration>{counting}{listening}</definitions>'
    )


@lru_cache(maxsize=64)
def mission(version: int, more: str = "") -> Definitions:
    """The mission read, once for each version."""
    return read_text(text(version, more), file=f"version_{version}_{more}.bpmn")


def version_of(definitions: Definitions) -> int:
    """The version of which a robot has its part."""
    found = re.search(rb"(?:\bn = |version, kept, mended = |\bversion = )(\d+)", definitions.source)
    assert found is not None
    number = int(found[1])
    return number // 1000 if found[0].startswith(b"n") else number
