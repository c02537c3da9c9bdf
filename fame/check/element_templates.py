"""Element templates for Camunda Modeler: message types, payloads and behaviours to choose from.

They follow the schema of Camunda 7; `of_camunda8` makes others of them. A template sets `camunda:property` entries, as
a person would by hand, so a model that was made with templates is read like any other. `templates` gives the files:
what to publish, what to receive, data objects, calls, services, properties of the team, and topics of the robots of a
world. Each template shows the other entries of the properties panel too, since a signal is chosen there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fame.bpmn.reader.dialects.extensions import QOS_CHOICES
from fame.bpmn.topics import TTL
from fame.check.library import Behaviour
from fame.config.scalars import scalar
from fame.middleware import messages

Template = dict[str, Any]

SCHEMA = "https://unpkg.com/@camunda/element-templates-json-schema/resources/schema.json"
CAMUNDA8 = "https://unpkg.com/@camunda/zeebe-element-templates-json-schema/resources/schema.json"
PACKAGES = ("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs")
"""Packages whose types can be chosen."""
COMMON = (
    "std_msgs/msg/Bool",
    "std_msgs/msg/ColorRGBA",
    "std_msgs/msg/Empty",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Int32",
    "std_msgs/msg/String",
    "geometry_msgs/msg/Point",
    "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/Vector3",
    "geometry_msgs/msg/Vector3Stamped",
    "geometry_msgs/msg/Wrench",
)
"""Types with templates of their own, in which the fields of the payload are there to be filled in."""
THROWS = ("bpmn:IntermediateThrowEvent", "bpmn:EndEvent")
CATCHES = ("bpmn:StartEvent", "bpmn:IntermediateCatchEvent", "bpmn:BoundaryEvent")
RECEIVES = (*CATCHES, "bpmn:ReceiveTask")
TIMED = ("bpmn:Process", "bpmn:Activity", "bpmn:IntermediateCatchEvent")
"""Where a deadline can be: everything else is left in the instant in which it is entered."""
AT_ONCE = ("bpmn:StartEvent", "bpmn:BoundaryEvent", *THROWS)
_QOS = "qos"


def templates(
    behaviours: Iterable[Behaviour], types: Iterable[str] = (), robots: Iterable[tuple[str, str, bool]] = ()
) -> dict[str, list[Template]]:
    """Return the templates by the name of their file, without its ending.

    `types`: message types of the project. `robots`: topics of robots, with type, and whether the robot publishes it.
    """
    known = list({one.name: one for one in behaviours}.values())
    own = [*dict.fromkeys((*types, *COMMON))]
    bodies = {"robots": [_of_robot(*one) for one in sorted({*robots})]}
    return {
        "publish": [_publish(own), _send(own), *map(_publish_type, own)],
        "receive": [_receive(own), _correlate(own)],
        "data": [*map(_inputs, filter(lambda one: one.inputs, known)), *map(_fields, filter(fields_of, own))],
        "library": [_call(one) for one in known],
        "services": [_ask("service", "srv", "Request"), _ask("action", "action", "Goal")],
        "properties": [_deadline(), _requirement(), _annotation()],
    } | (bodies if bodies["robots"] else {})


def of_camunda8(template: Mapping[str, Any]) -> Iterator[Template]:
    """Return templates for the modeler of Camunda 8 that set the same, as `zeebe:property` entries.

    A template of theirs takes away the signal or message of its event but for the one that it names. So each is for one
    type of event, and has the name as an entry.
    """
    entries = [made for entry in template["properties"] for made in _of_camunda8(entry)]
    made = {**template, "$schema": CAMUNDA8, "properties": entries}
    refers = _REFERS.get(template["id"].split(".")[1])
    for place in template["appliesTo"] if refers else ():
        kind = refers if place in (*CATCHES, *THROWS) else "Message"
        name = {"label": f"{kind} name", "type": "String", "binding": {"type": f"bpmn:{kind}#property", "name": "name"}}
        type = {"value": place} | ({} if "Task" in place else {"eventDefinition": f"bpmn:{kind}EventDefinition"})
        id = f"{template['id']}.{place.removeprefix('bpmn:')}"
        yield made | {"id": id, "appliesTo": [place], "elementType": type, "properties": [name, *entries]}
    others = [one for one in template["appliesTo"] if one not in (*CATCHES, *THROWS)]
    if others and not refers:
        yield made | {"appliesTo": others}


_REFERS = dict.fromkeys(("publish", "receive", "robot"), "Signal") | dict.fromkeys(("send", "correlate"), "Message")
"""First word of a template's name -> what its events refer to."""


def _of_camunda8(entry: Template) -> Iterator[Template]:
    binding = entry["binding"]
    if binding["name"] == "calledElement":
        yield entry | {"binding": _called("processId")}
        for variables in ("propagateAllParentVariables", "propagateAllChildVariables"):  # as a call without mappings
            yield {"type": "Hidden", "value": True, "binding": _called(variables)}
    elif binding["type"] == "property":
        yield entry
    elif entry["value"]:
        yield entry | {"binding": binding | {"type": "zeebe:property"}}
    else:  # or it would write an empty property; what is optional has no constraints
        kept = {name: value for name, value in entry.items() if name != "constraints"}
        yield kept | {"binding": binding | {"type": "zeebe:property"}, "optional": True}


def _called(property: str) -> Template:
    return {"type": "zeebe:calledElement", "property": property}


def message_types(folders: Iterable[Path]) -> list[str]:
    """Register the types of some folders, and return those of messages."""
    return [name for folder in folders for name in messages.register_files(folder) if "/msg/" in name]


def write(templates: Sequence[Template]) -> str:
    """Return the text of a file."""
    return json.dumps(templates, indent=2) + "\n"


# ---- properties of a team --------------------------------------------------------------------------------------------


def _deadline() -> Template:
    bound = _text("deadline", "Deadline", "a duration: it is left within this time after it was entered")
    bound["placeholder"] = "PT5S"
    text = "A deadline, which every run judges, and the requirement that the element is for."
    return _template("deadline", "Deadline and requirement", text, TIMED, [bound, _required()])


def _requirement() -> Template:
    return _template("requirement", "Requirement", "The requirement that the event is for.", AT_ONCE, [_required()])


def _required() -> Template:
    return _text("requirement", "Requirement", "the id of what it is for, in fame check --report")


def _annotation() -> Template:
    text = {"label": "Property", "type": "Text", "value": "property NAME: after ROBOT throws /topic, ROBOT completes"}
    said = "A sentence about the team, which every run judges. Drag its line to what it is about."
    entry = text | {"binding": _attribute("text")}
    return _template("property", "Property of the team", said, ("bpmn:TextAnnotation",), [entry])


# ---- topics ----------------------------------------------------------------------------------------------------------


def _publish(own: Sequence[str]) -> Template:
    payload = _text("payload", "Payload", "YAML or JSON with ${variables}; nothing sends a message of defaults")
    payload["placeholder"] = "{x: ${x_weed}, y: ${y_weed}}"
    text = "Throws a signal as a message on the topic of its name."
    return _template(
        "publish", "ROS 2 publish", text, THROWS, [_types(own), payload, _scope(), *_delivery(), *_qos()], qos=True
    )


def _send(own: Sequence[str]) -> Template:
    payload = _text("payload", "Payload", "YAML or JSON with ${variables}; nothing sends a message of defaults")
    to = _text("to", "To", "the robot that receives it, as ${closest} or Tractor_${n}; nothing: all robots")
    text = "Sends a BPMN message: to one robot, or to each instance whose correlation keys fit."
    fields = [_types(own), payload, to, *_delivery(), *_qos()]
    return _template("send", "ROS 2 send message", text, ("bpmn:SendTask", *THROWS), fields, qos=True)


def _publish_type(type: str) -> Template:
    """With the type's fields at their defaults as payload."""
    fields = [_property("type", "Hidden", type)]
    value = payload_of(type)
    if value:
        fields.append(_text("payload", "Payload", "a ${variable} may stand for any value") | {"value": value})
    text = f"Throws a signal as a {type} on the topic of its name."
    return _template(
        f"publish.{_dotted(type)}", f"ROS 2 publish {_short(type)}", text, THROWS, [*fields, _scope(), *_delivery()]
    )


def _receive(own: Sequence[str]) -> Template:
    text = "Catches a message on the topic of the signal's name. The fields go to the data object that it points to."
    return _template("receive", "ROS 2 receive", text, RECEIVES, [_types(own), _queue(), _scope(), *_qos()], qos=True)


def _correlate(own: Sequence[str]) -> Template:
    key = _text("correlate", "Correlate by", "variables that the message must match, as order_id or order_id = number")
    text = "Receives only the message whose field has the value of the variable: the answer to this robot's own order."
    return _template(
        "correlate", "ROS 2 receive correlated message", text, RECEIVES, [_types(own), key, _queue(), *_qos()], qos=True
    )


def _queue() -> Template:
    queue = _text("queue", "Queue", "how many messages it keeps from the time its scope is entered; nothing: none")
    return queue | {"constraints": {"pattern": {"value": r"\d*", "message": "a whole number"}}}


def _types(own: Sequence[str]) -> Template:
    names = [name for name in messages.types() if name.split("/")[:2] in [[package, "msg"] for package in PACKAGES]]
    ordered = [*own, *(name for name in names if name not in own)]
    return _property("type", "Dropdown", ordered[0], label="Message type") | {"choices": _choices(ordered)}


def _of_robot(topic: str, type: str, publishes: bool) -> Template:
    """What a robot of the world publishes is received, what it obeys is published; by its own robot only."""
    fixed = [_property("type", "Hidden", type), _property("scope", "Hidden", "robot")]
    payload = _text("payload", "Payload", "a ${variable} may stand for any value") | {"value": payload_of(type)}
    verb, where, more = ("Receive", RECEIVES, _queue()) if publishes else ("Publish", THROWS, payload)
    text = f"A {type} on the topic {topic} of the robot: give its signal this name."
    id, name = f"robot.{verb.lower()}.{topic}.{_short(type)}", f"{verb} {topic} of the robot ({_short(type)})"
    return _template(id, name, text, where, [*fixed, more])


def _ask(what: str, kind: str, part: str) -> Template:
    """A service or an action that a service task calls."""
    fields = [
        _text(what, f"Name of the {what}", "relative to the robot, unless it begins with /"),
        _text("type", "Type", f"package/{kind}/Name"),
        _text("payload", part, "YAML or JSON with ${variables}"),
    ]
    text = f"Calls a ROS 2 {what}, and waits for its result."
    made = _template(what, f"ROS 2 {what}", text, ("bpmn:Task", "bpmn:ServiceTask"), fields)
    return made | {"elementType": {"value": "bpmn:ServiceTask"}}


def _delivery() -> Iterator[Template]:
    ways = [{"name": "once", "value": ""}, {"name": "until each robot has acknowledged it", "value": "acknowledged"}]
    yield _property("delivery", "Dropdown", "", label="Is sent") | {"choices": ways}
    ttl = _text("ttl", "Time to live", f"seconds in which an acknowledged signal has to arrive; nothing: {TTL:g}")
    yield ttl | {"constraints": {"pattern": {"value": r"\d*\.?\d*", "message": "a time in seconds"}}}


def _scope() -> Template:
    whose = [{"name": "everyone's", "value": ""}, {"name": "the robot's own", "value": "robot"}]
    return _property("scope", "Dropdown", "", label="Topic is") | {"choices": whose}


def _qos() -> Iterator[Template]:
    """The QoS of signals unless the model sets another."""
    for policy, value in (("reliability", "reliable"), ("durability", "volatile")):
        entry = _property(f"qos.{policy}", "Dropdown", value, label=policy.capitalize())
        yield entry | {"choices": _choices(QOS_CHOICES[policy]), "group": _QOS}


def payload_of(type: str) -> str:
    """Return a payload that says every field of a type, at its default, but for times; empty if it has none."""
    import yaml

    value = _without_stamps(messages.default_payload(type))
    if value == {}:
        return ""

    class Quoting(yaml.SafeDumper):
        """Quotes each text that `scalar` would read as another value, such as ``1e3``."""

    def represent(dumper: Any, text: str) -> Any:
        return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if scalar(text) == text else "'")

    Quoting.add_representer(str, represent)
    text: str = yaml.dump(value, Dumper=Quoting, default_flow_style=True, sort_keys=False, width=1000)
    return text.removesuffix("...\n").strip()


def _without_stamps(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _without_stamps(inner) for name, inner in value.items() if name != "stamp"}
    return value


# ---- data objects and calls ------------------------------------------------------------------------------------------


def _inputs(behaviour: Behaviour) -> Template:
    text = f"What {behaviour.label} needs. Drag its arrow onto the call activity, which then sets these variables."
    fields = [_text(name, name, "a value or a ${variable}") for name in behaviour.inputs]
    return _template(
        f"inputs.{behaviour.name}", f"Data for {behaviour.label}", text, ("bpmn:DataObjectReference",), fields
    )


def _fields(type: str) -> Template:
    text = f"Takes the fields of a caught {type}: drag the arrow of the event onto it."
    fields = [_text(name, name, "leave it empty: the message sets it") for name in fields_of(type)]
    return _template(f"fields.{_dotted(type)}", f"Data of {_short(type)}", text, ("bpmn:DataObjectReference",), fields)


def fields_of(type: str) -> tuple[str, ...]:
    """Return the last names of a type's fields, as a data object may take them; none if two of them are the same.

    A wrapper such as std_msgs/msg/String has none: it goes to a variable named like the signal.
    """
    names = () if messages.is_wrapper(type) else tuple(_leaves(_without_stamps(messages.default_payload(type))))
    return names if len(set(names)) == len(names) else ()


def _leaves(value: Mapping[str, Any]) -> Iterator[str]:
    for name, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _leaves(inner)
        else:
            yield name


def _call(behaviour: Behaviour) -> Template:
    name = {"label": "Name", "type": "String", "value": behaviour.label, "binding": _attribute("name")}
    called = {"type": "Hidden", "value": behaviour.name, "binding": _attribute("calledElement")}
    made = _template(
        f"call.{behaviour.name}", behaviour.label, behaviour.documentation, ("bpmn:Task", "bpmn:CallActivity"),
        [name, called],
    )  # fmt: skip
    return made | {"elementType": {"value": "bpmn:CallActivity"}}


# ---- what templates are made of --------------------------------------------------------------------------------------


def _template(
    id: str, name: str, description: str, applies_to: Sequence[str], properties: list[Template], *, qos: bool = False
) -> Template:
    groups = {"groups": [{"id": _QOS, "label": "Quality of service"}]} if qos else {}
    head = {"$schema": SCHEMA, "name": name, "id": f"fame.{id}", "description": " ".join(description.split())}
    return head | {"appliesTo": list(applies_to), "entriesVisible": True} | groups | {"properties": properties}


def _property(name: str, type: str, value: str, *, label: str = "") -> Template:
    """One that sets a `camunda:property`."""
    labelled = {"label": label} if label else {}
    return labelled | {"type": type, "value": value, "binding": {"type": "camunda:property", "name": name}}


def _text(name: str, label: str, description: str) -> Template:
    return _property(name, "String", "", label=label) | {"description": description}


def _attribute(name: str) -> Template:
    """The binding to an attribute of the BPMN element."""
    return {"type": "property", "name": name}


def _choices(values: Iterable[str]) -> list[Template]:
    return [{"name": value, "value": value} for value in values]


def _dotted(type: str) -> str:
    return type.replace("/msg/", ".")


def _short(type: str) -> str:
    return type.rpartition("/")[2]
