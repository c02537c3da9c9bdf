"""A name of a class or type means one thing: those defined more than once are listed here, each with its reason."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
EXPECTED = {
    "Body": "the content of a process: as the file says it, and compiled",
    "Event": "an element of BPMN, and what happened at a time, as in process mining",
    "Evaluate": "one function of the variables: of expressions in models and in pipelines",
    "Expression": "a text to evaluate: of BPMN, and the processor that pipelines name so",
    "Finding": "what `fame check` reports, with and without --explore",
    "Node": "of XML, of a compiled process, and of ROS 2",
    "Participant": "of a BPMN collaboration, and of a DDS domain",
    "Point": "x and y: in pixels of a drawing, and in metres of the world",
    "Property": "of the extension elements of a model, and of a team that a monitor judges",
    "Recording": "of a run (MCAP), and of the joints of an arm",
    "Result": "of a run, and of a processor of a pipeline",
    "Threshold": "the processor that pipelines name so, and the key of a learning file",
}
"""The names that a reader expects in several places."""


def defined(tree: ast.Module) -> Iterator[str]:
    """The public classes, type aliases and type variables of a module."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation) == "TypeAlias":
            yield ast.unparse(node.target)
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name[0].isupper() and not name.isupper():
                yield name


def homonyms() -> dict[str, list[str]]:
    """Names that several modules define, with these modules."""
    found = defaultdict(list)
    for package in ("fame", "robots", "sim2d"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for name in defined(ast.parse(path.read_text(encoding="utf-8"))):
                if not name.startswith("_"):
                    found[name].append(str(path.relative_to(ROOT)))
    return {name: places for name, places in found.items() if len(places) > 1}


def test_a_name_means_one_thing() -> None:
    found = homonyms()
    new = {name: found[name] for name in sorted(found.keys() - EXPECTED.keys())}
    assert new == {}, "give these a name of their own, or a reason in EXPECTED"
    assert sorted(EXPECTED.keys() - found.keys()) == [], "these name one thing"
