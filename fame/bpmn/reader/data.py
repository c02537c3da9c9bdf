"""Reads data objects with the variables that they hold, and data associations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal

from fame.bpmn.model import Assignment, DataObject, Expression
from fame.bpmn.reader.context import Context, boolean_attribute
from fame.bpmn.reader.dialects import read_extensions
from fame.bpmn.reader.dialects.extensions import take_data_values
from fame.bpmn.reader.expressions import code_of, is_name, mapping_source, variable_name
from fame.bpmn.reader.xml import BPMN, Node, Parts, child, children, line_of, local_name, resolve, text_of
from fame.dataclasses import dataclass

_PLACEHOLDER = "__targetRef_placeholder"
"""A property that modelers generate because the schema requires a target of an association."""
_JBPM_NAMESPACE = "http://www.jboss.org/drools"
"""In files of jBPM, the value assigned to an input of a task is a text, not an expression."""
_KINDS: Mapping[str, Literal["object", "input", "output", "store", "property"]] = {
    "dataObjectReference": "object",
    "dataObject": "object",
    "dataStoreReference": "store",
    "dataStore": "store",
    "property": "property",
    "dataInput": "input",
    "dataOutput": "output",
}
_SCOPES = ("process", "subProcess", "transaction", "adHocSubProcess", "definitions")
_ENDS = {"dataInputAssociation": "sourceRef", "dataOutputAssociation": "targetRef"}


def shared_stores(context: Context, process: Node) -> Iterator[Node]:
    """Data stores outside of a process, in another pool or at the root, that its data associations refer to.

    Robots share no memory, so each process gets its own copy.
    """
    known: set[Node] = set()
    for association in process.iter(*(f"{{{BPMN}}}{kind}" for kind in _ENDS)):
        for reference in children(association, _ENDS[local_name(association)]):
            store = context.find_in_file(process, text_of(reference))
            if store is None or store in known or local_name(store) not in ("dataStoreReference", "dataStore"):
                continue
            if process not in store.iterancestors():
                known.add(store)
                yield store


def data_elements(process: Node, stores: Sequence[Node]) -> list[Node]:
    """Return all data elements of a process, and the shared stores outside of it."""
    return [*process.iter(*(f"{{{BPMN}}}{kind}" for kind in _KINDS)), *stores]


def data_ids(data: Iterable[Node]) -> dict[str, str]:
    """Id of each data element -> id of the data object that it stands for.

    A data object stands for its first reference. Inputs, outputs and properties of activities and events stand for none
    (empty).
    """
    ids: dict[str, str] = {}
    data_object: dict[str, str] = {}
    for element in data:
        id = element.get("id", "")
        ids[id] = id if _belongs_to_scope(element) else ""
        if local_name(element) == "dataObjectReference":
            data_object.setdefault(element.get("dataObjectRef", ""), id)
    return {id: data_object.get(id, object_id) for id, object_id in ids.items()}


def data_variables(data: Iterable[Node]) -> dict[str, str]:
    """Id of each data element that holds a single variable -> the variable, named after the element by default.

    Includes the data inputs and outputs of activities and events.
    """
    variables: dict[str, str] = {}
    for element in data:
        names = [inner.get("name", "") for inner in element.iter() if inner.tag.endswith(("}property", "}parameter"))
                 and inner is not element]  # fmt: skip
        name = names[0] if len(names) == 1 else _own_variable(element) if not names else ""
        if is_name(name) and name != _PLACEHOLDER:
            variables[element.get("id", "")] = name
    return variables


def _own_variable(element: Node) -> str:
    """The variable of a data element without properties, or empty."""
    kind = _KINDS[local_name(element)]
    name = element.get("name", "")
    return name if kind in ("object", "store") or not name else variable_name(element)


def _belongs_to_scope(element: Node) -> bool:
    holder = element.getparent()
    if holder is not None and local_name(holder) == "ioSpecification":
        holder = holder.getparent()
    return element.get("name") != _PLACEHOLDER and holder is not None and local_name(holder) in _SCOPES


def read_data_objects(context: Context, parts: Parts) -> tuple[DataObject, ...]:
    objects = {one.get("id"): one for one in parts.get("dataObject", ())}
    referred = {one.get("dataObjectRef") for one in parts.get("dataObjectReference", ())}
    data = [_data_object(context, one, objects) for one in parts.get("dataObjectReference", ())]
    data += [_data_object(context, one, {}) for id, one in objects.items() if id not in referred]
    for element in objects.values():
        if element.get("id") in referred:
            context.register(element)
    data += [_data_object(context, one, {}) for one in parts.get("dataStoreReference", ())]
    rest = list(parts.get("property", ()))
    for specification in parts.get("ioSpecification", ()):
        rest += [*children(specification, "dataInput"), *children(specification, "dataOutput")]
    data += [_data_object(context, one, {}) for one in rest if one.get("name") != _PLACEHOLDER]
    return tuple(data)


def _data_object(context: Context, element: Node, objects: Mapping[str | None, Node]) -> DataObject:
    data_object = objects.get(element.get("dataObjectRef"))
    extensions = read_extensions(context, element)
    if data_object is not None and not extensions.properties and not extensions.values:
        extensions = read_extensions(context, data_object)
    kind = _KINDS[local_name(element)]
    name = element.get("name", "")
    values = take_data_values(extensions)
    if kind in ("property", "input", "output") and not values and name:
        variable = variable_name(element)
        values = ((variable, Expression(f"${{{variable}}}", "value", line_of(element))),)
    state = child(element, "dataState")
    documentation = child(element, "documentation")
    return DataObject(
        kind=kind,
        values=values,
        state=state.get("name", "") if state is not None else "",
        collection=any(
            boolean_attribute(context, one, "isCollection") for one in (element, data_object) if one is not None
        ),
        id=context.register(element),
        name=name,
        line=line_of(element),
        documentation=text_of(documentation).strip() if documentation is not None else "",
    )


@dataclass(slots=True)
class DataAssociations:
    """The data associations of a flow node: ids of data objects, explicit assignments, and copies."""

    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    assigned_in: tuple[Assignment, ...] = ()
    assigned_out: tuple[Assignment, ...] = ()
    copied_in: tuple[Assignment, ...] = ()
    copied_out: tuple[Assignment, ...] = ()


_NO_ASSOCIATIONS = DataAssociations()


def read_data_associations(
    context: Context, data: Mapping[str, str], variables: Mapping[str, str], parts: Parts
) -> DataAssociations:
    """Read the data associations of a flow node. One without a data object is a fault."""
    into, out = parts.get("dataInputAssociation", ()), parts.get("dataOutputAssociation", ())
    if not into and not out:
        return _NO_ASSOCIATIONS
    return DataAssociations(
        tuple(_ends(context, data, into, "sourceRef")),
        tuple(_ends(context, data, out, "targetRef")),
        tuple(_assignments(context, variables, into)),
        tuple(_assignments(context, variables, out)),
        tuple(_copies(context, variables, into)),
        tuple(_copies(context, variables, out)),
    )


def required_outputs(parts: Parts) -> tuple[str, ...]:
    """Return the names of the data outputs that are required in every output set of an activity."""
    required: list[str] = []
    for specification in parts.get("ioSpecification", ()):
        sets = [_references(one, "dataOutputRefs") - _references(one, "optionalOutputRefs")
                for one in children(specification, "outputSet")]  # fmt: skip
        wanted = set.intersection(*sets) if sets else set()
        names = [one.get("name", "") for one in children(specification, "dataOutput") if one.get("id") in wanted]
        required += [name for name in names if is_name(name) and name != _PLACEHOLDER]
    return tuple(required)


def _references(element: Node, tag: str) -> set[str]:
    return {text_of(one).strip() for one in children(element, tag)}


def _copies(context: Context, variables: Mapping[str, str], associations: Iterable[Node]) -> Iterable[Assignment]:
    """Copies between variables, optionally through a transformation. Associations with assignments have none."""
    for association in associations:
        target, source = child(association, "targetRef"), child(association, "sourceRef")
        into = resolve(variables, text_of(target)) if target is not None else None
        if into is None or child(association, "assignment") is not None:
            continue
        transformation = child(association, "transformation")
        expression = code_of(context, transformation) if transformation is not None else None
        out_of = resolve(variables, text_of(source)) if source is not None else None
        if expression is None and out_of is not None and out_of != into:
            expression = Expression(f"${{{out_of}}}", "value", line_of(association))
        if expression is not None:
            yield Assignment(into, expression)


def _ends(context: Context, data: Mapping[str, str], associations: Iterable[Node], end: str) -> Iterable[str]:
    for association in associations:
        context.register(association)
        for reference in children(association, end):
            text = text_of(reference).strip()
            object_id = resolve(data, text)
            if object_id is None:
                context.fault(
                    association, f"a data association refers to {text!r}: the process has no such data object"
                )
            if object_id:
                yield object_id


def _assignments(context: Context, variables: Mapping[str, str], associations: Iterable[Node]) -> Iterable[Assignment]:
    for association in associations:
        constant = _JBPM_NAMESPACE in association.nsmap.values()
        own = child(association, "targetRef")
        for assignment in children(association, "assignment"):
            source, target = child(assignment, "from"), child(assignment, "to")
            name = text_of(target).strip() if target is not None else ""
            if source is None or not name or not text_of(source).strip():
                context.fault(assignment, "an assignment needs from and to")
                continue
            if own is not None and name == text_of(own).strip():
                name = variables.get(name, name)
                expression = mapping_source(text_of(source), line_of(source)) if constant else code_of(context, source)
            else:
                expression = code_of(context, source)
            if expression is not None:
                yield Assignment(name[2:-1].strip() if name[:2] in ("${", "#{") else name, expression)
