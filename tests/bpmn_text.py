"""BPMN written by hand in tests: a document around what a test is about."""

from __future__ import annotations

import pytest

import fame
from fame.bpmn import read_text
from fame.bpmn.model import Body, Definitions, FlowNode
from fame.errors import ModelError

NAMESPACES = {
    "": "http://www.omg.org/spec/BPMN/20100524/MODEL",
    "bpmndi": "http://www.omg.org/spec/BPMN/20100524/DI",
    "dc": "http://www.omg.org/spec/DD/20100524/DC",
    "di": "http://www.omg.org/spec/DD/20100524/DI",
    "camunda": "http://camunda.org/schema/1.0/bpmn",
    "zeebe": "http://camunda.org/schema/zeebe/1.0",
    "xsi": "http://www.w3.org/2001/XMLSchema-instance",
    "ros": "http://ros",
    "data": "http://data",
    "qos": "http://qos",
    "callActivity": "http://callActivity",
}


def document(content: str, attributes: str = "") -> str:
    """A file with `content` at its root, in line 2."""
    declared = " ".join(f'xmlns{":" if prefix else ""}{prefix}="{uri}"' for prefix, uri in NAMESPACES.items())
    return (
        f'<definitions {declared} id="Definitions" targetNamespace="http://fame" {attributes}>\n{content}</definitions>'
    )


def process(content: str, root: str = "", attributes: str = "") -> str:
    """A file with one process ``P`` that holds `content` (in line 3); `root` stands beside it."""
    return document(f'<process id="P" isExecutable="true" {attributes}>\n{content}</process>{root}')


def body_of(content: str, root: str = "", attributes: str = "") -> Body:
    """What the reader makes of the content of a process."""
    return read_text(process(content, root, attributes), file="test.bpmn").processes[0].body


def node_of(content: str, root: str = "", attributes: str = "") -> FlowNode:
    """The first flow node of such a process."""
    return body_of(content, root, attributes).nodes[0]


def notes_of(definitions: Definitions) -> list[str]:
    """The texts of its notes."""
    return [note.text for note in definitions.notes]


def extensions(content: str) -> str:
    """Extension elements."""
    return f"<extensionElements>{content}</extensionElements>"


def properties(**named: str) -> str:
    """Extension elements with Camunda properties; ``_`` in a name after ``qos`` is a dot."""
    written = "".join(
        f'<camunda:property name="{name.replace("qos_", "qos.", 1)}" value="{value}"/>' for name, value in named.items()
    )
    return extensions(f"<camunda:properties>{written}</camunda:properties>")


def compiled(text: str) -> None:
    """Read a file and compile its processes, as for a run."""
    definitions = read_text(text, file="bad.bpmn")
    for process in definitions.processes:
        fame.Simulation(definitions, process.id)


def refused(text: str) -> ModelError:
    """The error of a file that cannot be read or compiled: one line, that names the file."""
    with pytest.raises(ModelError) as caught:
        compiled(text)
    assert "\n" not in str(caught.value)
    assert caught.value.file == "bad.bpmn"
    return caught.value
