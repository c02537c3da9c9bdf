"""Forms of form-js in files of their own: ``*.form`` beside a model, as Camunda Modeler saves them.

A task names the form by its id, as an embedded one. A model that is split has it embedded, so that robots have it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from fame.bpmn.model import Definitions, FlowNode, FormField, Human, Task
from fame.bpmn.model.forms import given, unfit_value
from fame.bpmn.reader.dialects.forms import form_js


def linked_form(definitions: Definitions, id: str) -> str:
    """Return the JSON of the form with this id in a `.form` file beside the model; empty if no file has it."""
    folder = definitions.path.parent if id and definitions.path is not None else None
    for path in sorted(folder.glob("*.form")) if folder is not None else ():
        with suppress(OSError, ValueError, RecursionError):
            found = json.loads(path.read_bytes())
            if isinstance(found, dict) and found.get("id") == id:
                return json.dumps(found)
    return ""


def form_of(definitions: Definitions, human: Human) -> tuple[FormField, ...]:
    """Return the fields of a task's form; what keeps a linked one from being drawn is a field of kind ``other``."""
    text = linked_form(definitions, human.linked)
    try:
        return form_js(text) if text else (*_missing(human.linked), *human.form)
    except ValueError as error:
        return (FormField(kind="other", label=f"Its form {human.linked} cannot be read: {error}"), *human.form)


def unfit_values(nodes: Iterable[tuple[Definitions, FlowNode]], element: str, values: Mapping[str, Any]) -> str:
    """Return what is wrong with the values that a person gives to a task, by its form; empty if nothing is."""
    forms = (form_of(home, node.human) for home, node in nodes if node.id == element and isinstance(node, Task))
    return next((text for form in forms if (text := unfit_value(form, values))), "") if values else ""


def left_out(nodes: Iterable[tuple[Definitions, FlowNode]], element: str, values: Mapping[str, Any]) -> list[str]:
    """Return the keys of the fields that the form of a task requires and that have no value."""
    forms = (form_of(home, node.human) for home, node in nodes if node.id == element and isinstance(node, Task))
    return list(dict.fromkeys(field.key for form in forms for field in form
                              if field.required and field.key and not given(values, field.key)))  # fmt: skip


def _missing(id: str) -> tuple[FormField, ...]:
    text = f"Its form {id} is in no .form file beside the model, and not embedded."
    return (FormField(kind="other", label=text),) if id else ()
