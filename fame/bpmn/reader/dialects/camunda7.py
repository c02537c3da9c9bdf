"""Camunda 7 (``http://camunda.org/schema/1.0/bpmn``): properties, mappings, services. Also the form of the FAME paper.

Activiti, its predecessor, and Flowable use the same names in their own namespaces.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Set
from dataclasses import replace
from difflib import get_close_matches

from fame.bpmn.model import Assignment, Expression
from fame.bpmn.reader.context import Context
from fame.bpmn.reader.dialects.extensions import WORD, Extensions, Property
from fame.bpmn.reader.dialects.forms import form_data
from fame.bpmn.reader.expressions import (
    code_expression,
    flow_mapping,
    flow_sequence,
    has_placeholders,
    mapping_source,
    variable_or_expression,
)
from fame.bpmn.reader.xml import ACTIVITI, CAMUNDA, FLOWABLE, Node, line_of, local_name, text_of

IGNORED: Set[str] = {
    "formRefBinding", "formRefVersion", "formHandlerClass",
    "candidateStarterUsers", "candidateStarterGroups", "potentialStarter",
    "dueDate", "followUpDate", "priority", "asyncBefore", "asyncAfter", "async", "jobPriority",
    "taskPriority", "failedJobRetryTimeCycle", "initiator", "field", "variableEvents", "variableName",
    "calledElementVersion", "calledElementVersionTag", "calledElementTenantId",
}  # fmt: skip
"""Names without effect in FAME; each gets a note. `historyTimeToLive`, which the modeler always writes, gets none."""
_SIMILARITY = 0.9
"""Minimal similarity (difflib ratio) of an unknown attribute and the one that is meant."""
_NO_JAVA = "FAME does not run Java: use a script task, or name a registered operation"
_VENDOR_TASK = "it is a vendor-specific task of type {}; use a script task, or name a registered operation"
REFUSED: Mapping[str, str] = {
    "class": f"it runs the Java class {{}}; {_NO_JAVA}",
    "delegateExpression": f"it runs the delegate expression {{}}; {_NO_JAVA}",
    "connector": "it runs a connector; use a script task, or name a registered operation",
    "decisionRef": "it asks the DMN decision {}; decide with a gateway or a script task",
    "caseRef": "it calls the CMMN case {}; call a process",
    **dict.fromkeys(
        ("variableMappingClass", "variableMappingDelegateExpression"),
        "its mapping is the Java class {}; write it as camunda:in and camunda:out",
    ),
    "resource": "its script is the resource {}; put the script into the task",
}


def element(context: Context, node: Node, extensions: Extensions) -> None:
    name = local_name(node)
    read = _ELEMENTS.get(name)
    if read is not None:
        read(context, node, extensions)
    elif name in REFUSED:
        extensions.refused = REFUSED[name].format("")
    elif name in ("executionListener", "taskListener"):
        context.note(node, f"{_prefixed(node, name)} is not run: FAME has no listeners", "warning")
    elif name in IGNORED:
        context.note(node, f"{_prefixed(node, name)} has no effect")


def _prefixed(node: Node, name: str) -> str:
    """The name of an element or attribute with the prefix of the file."""
    prefixes = {uri: prefix for prefix, uri in node.nsmap.items() if prefix}
    return f"{next((prefixes[uri] for uri in (CAMUNDA, FLOWABLE, ACTIVITI) if uri in prefixes), 'camunda')}:{name}"


def attribute(context: Context, node: Node, name: str, value: str, extensions: Extensions) -> None:
    """Read an attribute of a BPMN element."""
    if name in REFUSED:
        extensions.refused = REFUSED[name].format(value)
    elif name == "type" and value.strip() not in ("", "external", "external-worker"):
        extensions.refused = _VENDOR_TASK.format(value)
    elif name in _ATTRIBUTES:
        setattr(extensions, _ATTRIBUTES[name], value.strip())
    elif name in PEOPLE:
        add_people(context, node, extensions, name, value)
    elif name == "expression":
        extensions.script = code_expression(context, node, value.strip(), None, line_of(node))
    elif name == "dueDate" and value.strip().startswith("P"):  # a duration; a date is for those who plan
        extensions.properties.setdefault("deadline", Property(value.strip(), line_of(node)))
    elif name == "calledElementBinding" and value.strip() in ("version", "versionTag"):
        text = f"{_prefixed(node, name)}={value!r} has no effect: the process that is there is called, in any version"
        context.note(node, text, "warning")
    elif name in IGNORED:
        context.note(node, f"{_prefixed(node, name)} has no effect")
    elif name not in SHARED_ATTRIBUTES:
        meant = get_close_matches(name, SHARED_ATTRIBUTES | IGNORED, n=1, cutoff=_SIMILARITY)
        if meant:
            context.note(node, f"{_prefixed(node, name)} is not read; did you mean {meant[0]}?", "warning")


PEOPLE = ("assignee", "candidateUsers", "candidateGroups")


def add_people(context: Context, node: Node, extensions: Extensions, name: str, value: str) -> None:
    """Add those who may complete a task: names with commas. Expressions are not evaluated; each gets a warning."""
    people = extensions.groups if name == "candidateGroups" else extensions.users
    value = value.strip()
    for part in filter(None, map(str.strip, [value] if value.startswith("=") else _COMMA.split(value))):
        if part.startswith("=") or has_placeholders(part):
            context.note(node, f"{name}={part!r} has no effect: expected names, not an expression", "warning")
        else:
            people.append(part)


_COMMA = re.compile(r",(?![^{}]*\})")
"""A comma outside ``${...}``."""


def _form_data(context: Context, node: Node, extensions: Extensions) -> None:
    extensions.form = tuple(form_data(node, lambda text: context.note(node, text, "warning")))


_ATTRIBUTES = {
    "formKey": "linked",
    "formRef": "linked",
    "topic": "operation",
    "collection": "collection",
    "elementVariable": "element_variable",
    "resultVariable": "result",
    "errorCodeVariable": "code_variable",
    "escalationCodeVariable": "code_variable",
    "errorMessageVariable": "message_variable",
}


def _properties(context: Context, node: Node, extensions: Extensions) -> None:
    for child in node:
        name = child.get("name", "").strip()
        if name:
            extensions.put(context, child, name, child.get("value", ""))


def _input_output(context: Context, node: Node, extensions: Extensions) -> None:
    for child in node:
        if local_name(child) == "connector":
            extensions.refused = REFUSED["connector"]
            continue
        name = child.get("name", "").strip()
        if not name:
            context.fault(child, f"a {_prefixed(child, local_name(child))} has no name: give the variable that it sets")
            continue
        source = _parameter(context, child)
        outwards = local_name(child) == "outputParameter"
        if source is not None:
            into = extensions.outputs if outwards else extensions.inputs
            if any(each.target == name for each in into):
                context.note(child, f"sets {name!r} twice: only the last one counts", "warning")
            into.append(Assignment(name, source))
        if not outwards and len(child) and local_name(child[0]) == "list" and not any(map(len, child[0])):
            extensions.lists[name] = [Property(text_of(value), line_of(value)) for value in child[0]]
    inputs, written = {each.target for each in extensions.inputs}, set[str]()
    for place, mapping in enumerate(extensions.outputs):
        # The process has the earlier ones by then; an input hides its own.
        extensions.outputs[place] = replace(mapping, in_order=not written.isdisjoint(WORD.findall(mapping.source.text)))
        written |= {mapping.target} - inputs


def _parameter(context: Context, node: Node) -> Expression | None:
    """A text, script, list or map; lists and maps become flow-style YAML with ``${...}``. Others are a fault."""
    if not len(node):
        return mapping_source(text_of(node), line_of(node))
    content = node[0]
    kind, line = local_name(content), line_of(content)
    if len(node) == 1 and kind == "script":
        return code_expression(context, content, text_of(content).strip(), content.get("scriptFormat"), line)
    if len(node) == 1 and kind in ("list", "map"):
        return Expression(_flow(context, content), "payload", line)
    context.fault(content, f"<{kind}> in a parameter: expected text, or one script, list or map")
    return None


def _flow(context: Context, node: Node) -> str:
    """A list, map, value or entry as flow-style YAML. Anything else in a list or map is a fault."""
    kind = local_name(node)
    if kind == "list":
        return flow_sequence([_flow(context, each) for each in node])
    if kind == "map":
        return flow_mapping([(each.get("key", ""), _flow(context, each)) for each in node])
    if kind == "entry" and len(node) == 1:
        return _flow(context, node[0])
    if kind not in ("value", "entry") or len(node):
        context.fault(node, f"<{kind}> in a list or map: expected text, or one list or map")
    return text_of(node)


def _in(context: Context, node: Node, extensions: Extensions) -> None:
    if node.get("businessKey") is not None:
        context.note(node, "a business key has no effect")
        return
    _note_local(context, node)
    extensions.own_scope = True
    if node.get("variables") == "all":
        extensions.all_in = True
    else:
        _copy(context, node, extensions.inputs)


def _note_local(context: Context, node: Node) -> None:
    if node.get("local", "").strip().lower() == "true":
        text = f"local of {_prefixed(node, local_name(node))} has no effect: variables of enclosing scopes count, too"
        context.note(node, text, "warning")


def _out(context: Context, node: Node, extensions: Extensions) -> None:
    _note_local(context, node)
    extensions.own_scope = True
    if node.get("variables") == "all":
        extensions.all_out = True
    else:
        _copy(context, node, extensions.outputs)


def _copy(context: Context, node: Node, into: list[Assignment]) -> None:
    source, expression, target = node.get("source"), node.get("sourceExpression"), node.get("target", "").strip()
    if not target or not (source or expression):
        text = f"{_prefixed(node, local_name(node))} needs target and source (or sourceExpression), or variables='all'"
        context.fault(node, text)
        return
    seen = (
        mapping_source(expression, line_of(node)) if expression else variable_or_expression(context, node, source or "")
    )
    if seen is not None:
        into.append(Assignment(target, seen))


_ELEMENTS: Mapping[str, Callable[[Context, Node, Extensions], None]] = {
    "properties": _properties,
    "inputOutput": _input_output,
    "formData": _form_data,
    "in": _in,
    "out": _out,
}
_INNER = {"formField", "property", "inputParameter", "outputParameter", "list", "value", "map", "entry", "script"}
SHARED_ELEMENTS: Set[str] = {*_ELEMENTS, *_INNER}
SHARED_ATTRIBUTES: Set[str] = {*_ATTRIBUTES, *PEOPLE, *REFUSED, "expression", "type"}
"""The names that Flowable and Activiti share with Camunda 7."""
