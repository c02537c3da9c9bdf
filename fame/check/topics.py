"""Checks of topics: one known type each, payloads that fit it, and a sender and receiver.

The other end of a robot's own topics (``~/odom``) is its drivers, which are not checked.
"""

from __future__ import annotations

import ast
import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

from fame.bpmn.model import Expression, FlowNode, SignalDefinition, Topic
from fame.bpmn.topics import EMPTY_TYPE, TopicEnd, name_conflict, topic_table
from fame.check.element_templates import COMMON
from fame.check.endpoints import (
    TopicEndpoint,
    Topics,
    declared_type,
    endpoints_of,
    fields_taken,
    level_of,
    public_topics,
    select_topics,
    taken_by_prefix,
)
from fame.check.scope import CheckedProcess, CheckScope, Finding, Fix, FixKind, Level
from fame.engine import UNDEFINED
from fame.errors import MessageError, ModelError
from fame.middleware import messages
from fame.scripting.budget import BudgetExceeded
from fame.scripting.data import ExpressionError
from fame.scripting.effects import computed_topics, effects_of
from fame.scripting.python import called_name
from fame.scripting.python_effects import syntax_tree
from fame.text import ros_name, wrong_topic


def check_topic_types(scope: CheckScope) -> Iterator[Finding]:
    """Check the types of topics and ROS services, and whether what is sent and taken fits them."""
    processes = [process for one in scope.mission for process in one.processes]
    ends = {process: list(endpoints_of(process)) for process in processes}
    for process in scope.processes:
        yield from _services(process, scope.remote_types)
        yield from publish_findings(process)
    public = _judged(select_topics(processes, ends, private=False), scope)
    yield from (one for one in public if one.file in scope.files)
    for root in scope.roots:
        yield from _judged(select_topics(root.closure(), ends, private=True), scope)


# ---- types -----------------------------------------------------------------------------------------------------------


def _judged(topics: Topics, scope: CheckScope) -> Iterator[Finding]:
    for name, ends in topics.items():
        type = declared_type(ends)
        yield from _names(name, ends)
        yield from _types(name, ends)
        yield from () if scope.remote_types else _unknown(ends)
        for end in ends:
            if end.payload is not None and type is None:
                text = f"topic {name} has a payload but no type: set property type on one of its events"
                yield end.finding("error", text, _typed(end, scope, _fitting(end, end.payload)))
            elif end.payload is not None and type is not None:
                yield from payload_findings(end.process, end.node, end.payload, type)
            elif not end.throws and end.topic is not None:
                yield from _taking(end, end.topic, type, scope)
                yield from _correlating(end, end.topic, type)
        drawn = [end for end in ends if end.topic is not None]  # a script may do with what is there when it runs
        if type is None and name.startswith("~/") and drawn and not any(end.throws for end in ends):
            text = f"no event declares the type of the robot's topic {name}: set property type"
            yield drawn[0].finding("warning", text, _typed(drawn[0], scope, ()))


def _typed(end: TopicEndpoint, scope: CheckScope, fitting: Iterable[str]) -> Fix | None:
    """Give an end its type: that of the robot's body, or the first one that fits."""
    type = scope.bodies.get(end.name) or next(iter(fitting), "")
    return Fix(f"add type = {type}", end.node.id, "property", type, "type") if type and end.topic else None


def _fitting(end: TopicEndpoint, payload: Expression) -> Iterator[str]:
    """The usual types that a payload fits, if it says anything about its type."""
    said = payload.text.lstrip()[:1] == "{" or (payload.text.strip() and "${" not in payload.text)
    types = COMMON if said and payload.text.lstrip()[:1] != "=" else ()
    return (one for one in types if not any(payload_findings(end.process, end.node, payload, one)))


def _names(name: str, ends: Sequence[TopicEndpoint]) -> Iterator[Finding]:
    """Topics that are not valid in ROS 2: no middleware makes them. Names that are not those of their topic."""
    if text := wrong_topic(name, ends[0].label):
        yield ends[0].finding("error", text)
    labelled = [end for end in ends if end.label]
    if labelled and not text and ros_name(labelled[0].label) != labelled[0].label:
        yield labelled[0].finding("note", f"the name {labelled[0].label!r} becomes the topic {name}")
    for end in labelled[1:]:
        if end.label != labelled[0].label:
            text = name_conflict(name, end.label, labelled[0].node.display_name, labelled[0].label)
            yield end.finding("error", text)


def _types(name: str, ends: Sequence[TopicEndpoint]) -> Iterator[Finding]:
    typed = [end for end in ends if end.type is not None]
    for end in typed:
        if end.type != typed[0].type:
            there = f"{typed[0].node.display_name} says {typed[0].type}"
            text = f"topic {name} has type {end.type} here, but {there}: a topic has one type"
            yield end.finding("warning" if end.tries else "error", text)


def _unknown(ends: Sequence[TopicEndpoint]) -> Iterator[Finding]:
    for end in ends:
        if end.type is not None:
            try:
                messages.fields(end.type)
            except MessageError as error:
                yield end.finding("warning" if end.tries else "error", f"type {error}")


_KEY = re.compile(r"\$\{msg\.(\w+)[\w.]*\}")


def _correlating(end: TopicEndpoint, topic: Topic, type: str | None) -> Iterator[Finding]:
    """Correlation keys that find no field in the caught message: it is never received."""
    for name, source in end.node.keys_of(topic):
        match = _KEY.fullmatch(source.text)
        with suppress(MessageError):  # of a type that nobody knows
            fields = messages.fields(type or EMPTY_TYPE)
            if match is not None and match[1] not in fields:
                hint = "" if type is not None else ": set property type"
                text = (
                    f"correlates by {name}, but {type or EMPTY_TYPE} has no field {match[1]}: it receives nothing{hint}"
                )
                yield end.finding("error" if type is not None else "warning", text)


def _taking(end: TopicEndpoint, topic: Topic, type: str | None, scope: CheckScope) -> Iterator[Finding]:
    """Data objects and mappings that find no field in the caught message."""
    objects = [item for body in end.process.bodies() for item in body.data_objects if item.id in end.node.data_outputs]
    names = [name for item in objects for name in item.names]
    wanted = ", ".join([item.target for item in topic.takes] or names)
    if wanted and type is None:
        text = f"no event declares the type of topic {end.name}, so it is {EMPTY_TYPE}, which has no field for {wanted}"
        text += ": set property type"
        fitting = (one for one in COMMON if names and len(fields_taken(names, topic, one)) == len(names))
        yield end.finding("warning", text, _typed(end, scope, fitting))
    elif type is not None and names and not topic.takes and not fields_taken(names, topic, type):
        fields = ", ".join(messages.fields(type)) or "none"
        text = f"{type} has no field for {wanted}: expected names like its fields ({fields}) or <field>_..."
        yield end.finding("warning", text)
    for item in topic.takes:
        level: Level = "warning" if item.source.language == "feel" else "error"  # FEEL gives null instead
        for error in _misread(item.source, type):
            yield end.process.finding(level, f"reads what is not in the message: {error}", end.node, item.source.line)
    for name, field in taken_by_prefix(end.process, end.node, topic, type or "").items():
        text = f"fills `{name}` with field {field} because the names are alike: connect the event with the data object"
        yield end.finding("warning", text)


def _misread(source: Expression, type: str | None) -> Iterator[MessageError]:
    """The fields that a mapping reads, ``msg.point.x``, and that no message of a type has."""
    tree = effects_of(source).condition if type and source.language in ("juel", "feel") else None
    nodes = list(ast.walk(tree)) if tree is not None else []
    inner = {id(getattr(node, "func", getattr(node, "value", None))) for node in nodes}
    for node in nodes:
        read = ast.unparse(node) if isinstance(node, ast.Attribute) and id(node) not in inner else ""
        if re.fullmatch(r"msg(\.\w+)+", read) and (error := _unknown_field(str(type), read[4:])) is not None:
            yield error


def _services(process: CheckedProcess, remote: bool) -> Iterator[Finding]:
    """The ROS services and actions that service tasks call."""
    for node in process.nodes():
        service = node.service
        if service is not None and service.type:
            try:
                request = messages.goal_type(service.type) or messages.service(service.type)[0]
            except MessageError as error:
                if not remote:
                    yield process.finding("error", f"type {error}", node)
            else:
                if service.payload is not None:
                    yield from payload_findings(process, node, service.payload, request)


# ---- publishers and subscribers --------------------------------------------------------------------------------------


def check_topic_partners(scope: CheckScope) -> Iterator[Finding]:
    """Find public topics that are only published or only subscribed to."""
    public, level, files = public_topics(scope.mission), level_of(scope.mission), len(scope.mission)
    nodes = [node for one in scope.mission for process in one.processes for node in process.nodes()]
    thrown, taken = computed_topics(nodes, "publish"), computed_topics(nodes, "subscribe")
    where = (scope.definitions.file or "the file") if files == 1 else f"the {files} files of the mission"
    for name, ends in public.items():
        throws, catches = [end for end in ends if end.throws], [end for end in ends if not end.throws]
        drawn = next((end for end in ends if end.topic is not None and end.process in scope.processes), None)
        computed = taken if throws else thrown  # the other end may be there
        if drawn is None or (catches and (throws or name in scope.outside)) or name.startswith(computed):
            continue
        does, other = ("throws", "catches") if throws else ("waits for", "throws")
        similar = _similar(name, ends, public)
        text = f"{does} {name}, but nothing in {where} {other} it{f'; did you mean {similar}?' if similar else ''}"
        kind: FixKind = "signal" if drawn.node.defined(SignalDefinition) else "message"
        named = drawn.node.definitions or drawn.node.tag in ("sendTask", "receiveTask")
        fix = (
            Fix(f"rename it to {similar}", drawn.node.id, kind, similar.removeprefix("/"))
            if similar and named
            else None
        )
        yield drawn.finding(level, text, fix)


def _similar(name: str, ends: Sequence[TopicEndpoint], topics: Topics) -> str:
    """A topic of a similar name that lacks the other side; empty without."""
    throws = ends[0].throws
    lonely = {one.casefold(): one for one, its in topics.items() if all(end.throws != throws for end in its)}
    close = difflib.get_close_matches(name.casefold(), sorted(lonely), 1, 0.8)
    return lonely[close[0]] if close else ""


# ---- messages to pools of several robots -----------------------------------------------------------------------------


def check_addressing(scope: CheckScope) -> Iterator[Finding]:
    """Find messages to a pool of several robots that do not say which robot gets them."""
    pools = {pool.process: pool.name for pool in scope.definitions.participants if pool.multi_instance}
    processes = [process for process in scope.processes if scope.has_pool(process)] if pools else []
    many = {
        topic: pools[process.bpmn.id]
        for process in processes
        if process.bpmn.id in pools
        for topic, ends in _messages(process, throws=False).items()
        if ends
    }
    for process in processes:
        for topic, ends in _messages(process, throws=True).items():
            for end in ends if topic in many else ():
                if end.topic.to is None:
                    text = f"its message {topic} goes to every robot of the pool {many[topic]}"
                    yield process.finding("warning", f"{text}: property to selects one", end.node)


def _messages(process: CheckedProcess, *, throws: bool) -> dict[str, list[TopicEnd]]:
    """The elements of a process and its called processes that throw or catch messages, by topic."""
    messages: dict[str, list[TopicEnd]] = {}
    for process_inside in process.closure():
        try:
            by_topic = topic_table(process_inside.definitions, [process_inside.bpmn.id])
        except ModelError:  # reported as an error elsewhere
            continue
        for topic, use in by_topic.items():
            ends = use.throws if throws else use.catches
            messages.setdefault(topic, []).extend(end for end in ends if end.is_message)
    return messages


# ---- payloads --------------------------------------------------------------------------------------------------------


def payload_findings(process: CheckedProcess, node: FlowNode, expression: Expression, type: str) -> Iterator[Finding]:
    """Check the payload of an event or task, unless its type is unknown."""
    from fame.scripting.substitution import is_text, payload

    if expression.text.lstrip().startswith("="):  # FEEL is computed, all of it
        return
    computed: list[str] = []
    try:
        value = payload(expression.text, lambda variables, path, error: computed.append(path))[0]({})
    except ExpressionError:  # the compiler reports it
        return
    except (Exception, BudgetExceeded):  # a ${...} of constants that cannot be evaluated: no telling
        value = UNDEFINED
    if value is UNDEFINED and is_text(expression.text) and _has_fields(type):
        value = expression.text
    errors = [misfit(type, value)] if value is not UNDEFINED else []
    for error in (*(_unknown_field(type, path) for path in computed), *errors):
        if error is not None:
            yield process.finding("error", f"the payload does not fit: {error}", node, expression.line)


def publish_findings(process: CheckedProcess) -> Iterator[Finding]:
    """Check fields and literals of ``robot.publish("led", "std_msgs/msg/ColorRGBA", r=1.0)`` in scripts."""
    for node in process.nodes():
        if node.script is not None and "publish" in node.script.text and (tree := syntax_tree(node.script)) is not None:
            tried = (
                one for one in ast.walk(tree) if isinstance(one, ast.Try) and one.handlers
            )  # their errors are caught
            caught = {id(one) for each in tried for statement in each.body for one in ast.walk(statement)}
            for call in ast.walk(tree):
                if isinstance(call, ast.Call) and called_name(call) == "robot.publish" and len(call.args) == 2:
                    yield from _publish(process, node, call, "warning" if id(call) in caught else "error")


def _publish(process: CheckedProcess, node: FlowNode, call: ast.Call, level: Level) -> Iterator[Finding]:
    type = call.args[1]
    if not isinstance(type, ast.Constant) or not isinstance(type.value, str):
        return
    for keyword in call.keywords:
        try:
            error = misfit(type.value, {str(keyword.arg): ast.literal_eval(keyword.value)})
        except ValueError:  # not a literal
            error = _unknown_field(type.value, keyword.arg or "")
        if error is not None:
            yield process.finding(level, f"what is published does not fit: {error}", node, keyword.value.lineno)


def _has_fields(type: str) -> bool:
    """Whether only a mapping can fill it; a message with one field may be filled by a number."""
    try:
        return len(messages.fields(type)) > 1
    except MessageError:
        return False


def misfit(type: str, value: object) -> MessageError | None:
    """Return the error of creating a message from the value; None if it fits or the type is unknown."""
    try:
        messages.fields(type)
    except MessageError:
        return None
    try:
        messages.create(type, value)
    except MessageError as error:
        return error
    return None


def _unknown_field(type: str, path: str) -> MessageError | None:
    """The error of an unknown field (``pose.position.x``, ``points[0].x``); None if the type has it."""
    within = type
    for name in filter(None, re.sub(r"\[\d+\]", "", path).split(".")):
        try:
            known = messages.fields(within) if "/" in within else {}
        except MessageError:
            return None
        if name not in known:
            text = f"there is no such field; those of {within} are {', '.join(known) or 'none'}"
            return MessageError(text, type=type, field=path)
        within = known[name].partition("[")[0]
    return None
