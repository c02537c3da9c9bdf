"""Changes of a source by machine: each is valid Python again, and of the kind that it says."""

from __future__ import annotations

import ast

import pytest

from tests.mutants import applied, of_model, of_python, parsed

TEXT = """
def write(self, data):
    if self.size > 1 and not data:
        raise ValueError(data)
    self.file.write(data)
    self.file.sync()
    return {"size": self.size, "data": dict(data, first=1, last=2)}
"""


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("comparison", "if self.size >= 1 and not data:"),
        ("and, or", "if self.size > 1 or not data:"),
        ("negated", "if (not (self.size > 1 and not data)):"),
        ("not left out", "if self.size > 1 and data:"),
        ("one more", "if self.size > 2 and not data:"),
        ("left out", "pass"),
        ("swapped", "self.file.sync(); self.file.write(data)"),
        ("field left out", 'return {"data": dict(data, first=1, last=2)}'),
        ("field left out", 'return {"size": self.size, "data": dict(data, last=2)}'),
        ("nothing returned", "return None"),
    ],
)
def test_a_mutant_has_one_change(kind: str, line: str) -> None:
    texts = [applied(mutant, TEXT) for mutant in of_python("a.py", TEXT) if mutant.kind == kind]
    assert any(line in map(str.strip, text.splitlines()) for text in texts)
    assert all(ast.parse(text) and text != TEXT for text in texts)


def test_a_list_is_read_as_it_was_printed_and_finds_its_place_after_the_code_has_moved() -> None:
    for mutant in of_python("a.py", TEXT):
        assert parsed(str(mutant)) == mutant
        assert applied(parsed(str(mutant)), "\n\n" + TEXT) == "\n\n" + applied(mutant, TEXT)


def test_a_flow_of_a_model_is_left_out() -> None:
    text = '<bpmn:sequenceFlow id="F"/>\n<bpmndi:BPMNDiagram/>'
    (mutant,) = of_model("a.bpmn", text)
    assert applied(mutant, text) == "\n<bpmndi:BPMNDiagram/>"
