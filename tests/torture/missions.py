"""The small missions that teams run: three robots, at most ten elements, one version after the other."""

from __future__ import annotations

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


def _signal(tag: str, id: str, properties: str = "") -> str:
    more = f"<extensionElements><camunda:properties>{properties}</camunda:properties></extensionElements>"
    return f'<{tag} id="{id}">{more}<signalEventDefinition signalRef="tick"/></{tag}>'


def _listening(id: str, version: int) -> str:
    return _process(
        id,
        f'<startEvent id="{id}s"/><scriptTask id="{id}init"><script>version, kept = {version}, []</script></scriptTask>'
        + _signal("intermediateCatchEvent", f"{id}hear", '<camunda:property name="queue" value="50"/>')
        + f'<scriptTask id="{id}keep"><script>kept = kept + [tick]</script></scriptTask>',
        f"{id}s>{id}init", f"{id}init>{id}hear", f"{id}hear>{id}keep", f"{id}keep>{id}hear",
    )  # fmt: skip


def text(version: int) -> str:
    """A counts, and says its count on `/tick`; the others keep the counts that they receive."""
    payload = (
        '<camunda:property name="type" value="std_msgs/msg/Int32"/><camunda:property name="payload" value="${n}"/>'
    )
    counting = _process(
        "pa",
        f'<startEvent id="sa"/><scriptTask id="begin"><script>n = {1000 * version}</script></scriptTask>'
        '<intermediateCatchEvent id="pause"><timerEventDefinition><timeDuration>PT0.7S</timeDuration>'
        "</timerEventDefinition></intermediateCatchEvent>"
        '<scriptTask id="count"><script>n = n + 1</script></scriptTask>'
        + _signal("intermediateThrowEvent", "say", payload),
        "sa>begin", "begin>pause", "pause>count", "count>say", "say>pause",
    )  # fmt: skip
    listening = "".join(_listening(f"p{name.lower()}", version) for name in ROBOTS[1:])
    pools = "".join(f'<participant id="P{name}" name="{name}" processRef="p{name.lower()}"/>' for name in ROBOTS)
    return (
        f'<definitions xmlns="{_BPMN}" xmlns:camunda="{_CAMUNDA}" targetNamespace="t"><signal id="tick" name="tick"/>'
        f'<collaboration id="c">{pools}</collaboration>{counting}{listening}</definitions>'
    )


@lru_cache(maxsize=64)
def mission(version: int) -> Definitions:
    """The mission read, once for each version."""
    return read_text(text(version), file=f"version_{version}.bpmn")
