"""Faults by machine: which of the tests notice that a line is wrong?

A mutant is the source with one place changed: a comparison turned round, a condition negated, `and` for `or`, a number
one more, a call or an assignment left out, nothing returned; in a model a flow, a signal, a property or a number.
Each is tried in a copy of the tree: the tests named are run until one fails.

    python -m tests.mutants draw --seed 53 --missions 27 engine:5 robot:5    print a list, a mutant a line
    python -m tests.mutants run LIST -- tests -m 'not long'                 killed or survived, by which test

A list is text, `FILE:LINE:COLUMN KIND | before | after`, and can be repeated after the code has moved: of the mutants
that could be drawn with the same texts, the nearest to its line is meant.
``tests/mutants.txt`` was drawn before tests were moved to `make test-long`.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
ROOMS = {
    "engine": ["fame/engine"],
    "robot": ["fame/robot"],
    "deploy": ["fame/deploy"],
    "middleware": ["fame/middleware"],
    "explore": ["fame/check/explore"],
    "monitor": ["fame/monitor"],
}
OPPOSITE = {"==": "!=", "!=": "==", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "is": "is not", "is not": "is"}
OPPOSITE |= {"in": "not in", "not in": "in"}
COMPARISON = re.compile(r"\s(==|!=|<=|>=|<|>|is not|is|not in|in)\s")
IN_MODELS = (
    ("flow left out", re.compile(r"<(\w+:)?sequenceFlow [^>]*/>"), ""),
    ("other signal", re.compile(r'signalRef="[^"]+"'), 'signalRef="Nothing"'),
    ("not interrupting", re.compile(r'isInterrupting="false"'), 'isInterrupting="true"'),
    ("property left out", re.compile(r"<camunda:property [^>]*/>"), ""),
    ("condition negated", re.compile(r"(?<=>)\$\{[^}]+\}(?=</bpmn:conditionExpression>)"), None),
    ("longer", re.compile(r"(?<=>)PT\d+S(?=<)"), "PT999S"),
    ("other behaviour", re.compile(r'calledElement="[^"]+"'), 'calledElement="Land"'),
    ("other number", re.compile(r"(?<=[=<>(,] )\d+(\.\d+)?(?=[\s,)&])"), None),
)


class Mutant(NamedTuple):
    """A change of one place: file, line and column (from 1, in bytes), what kind, the text before and after."""

    file: str
    line: int
    column: int
    kind: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column} {self.kind} | {self.before!r} | {self.after!r}"


def parsed(text: str) -> Mutant:
    """Read a line of a list."""
    place, before, after = text.rstrip("\n").split(" | ")
    where, _, kind = place.partition(" ")
    file, line, column = where.rsplit(":", 2)
    return Mutant(file, int(line), int(column), kind, ast.literal_eval(before), ast.literal_eval(after))


# ---- drawing ---------------------------------------------------------------------------------------------------------


def of_python(file: str, text: str) -> Iterator[Mutant]:
    """All changes of a module."""
    lines = text.encode().splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def change(node: ast.AST, kind: str, after: str) -> Mutant:
        first = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        last = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        before = text.encode()[first:last].decode()
        return Mutant(file, node.lineno, node.col_offset + 1, kind, before, after)  # type: ignore[attr-defined]

    def source(node: ast.AST) -> str:
        return ast.get_source_segment(text, node) or ""

    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    for node in {inner: None for function in functions for inner in ast.walk(function)}:
        match node:
            case ast.Compare(ops=[_]) if word := COMPARISON.search(whole := source(node)):
                before = word[1]
                yield change(node, "comparison", f"{whole[: word.start(1)]}{OPPOSITE[before]}{whole[word.end(1) :]}")
            case ast.BoolOp(op=op):
                words = (" and ", " or ") if isinstance(op, ast.And) else (" or ", " and ")
                if words[0] in (whole := source(node)):
                    yield change(node, "and, or", whole.replace(*words, 1))
            case ast.If(test=test) | ast.IfExp(test=test):
                yield change(test, "negated", f"(not ({source(test)}))")
            case ast.Constant(value=int() as number) if not isinstance(number, bool):
                yield change(node, "one more", str(number + 1))
            case ast.Expr(value=ast.Call()) | ast.AugAssign():
                yield change(node, "left out", "pass")
            case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
                yield change(node, "left out", "pass")
            case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
                yield change(value, "nothing returned", "None")


def of_model(file: str, text: str) -> Iterator[Mutant]:
    """All changes of a .bpmn file."""
    end = text.find("BPMNDiagram")
    for kind, pattern, after in IN_MODELS:
        for hit in pattern.finditer(text, 0, end):
            line = text.count("\n", 0, hit.start()) + 1
            column = len(text[text.rfind("\n", 0, hit.start()) + 1 : hit.start()].encode()) + 1
            if after is None:
                after_hit = f"${{not ({hit[0][2:-1]})}}" if kind == "condition negated" else str(float(hit[0]) * 3 + 1)
            else:
                after_hit = after
            if after_hit != hit[0]:
                yield Mutant(file, line, column, kind, hit[0], after_hit)


def draw(seed: int, missions: int, rooms: dict[str, int]) -> Iterator[Mutant]:
    """Mutants of the shipped missions, then of each room, a file at most twice."""
    generator = random.Random(seed)
    shipped = sorted((ROOT / "models").glob("*.bpmn"))
    yield from drawn(generator, missions, [(path, of_model) for path in shipped], most=len(shipped))
    for room, count in rooms.items():
        files = sorted(path for folder in ROOMS[room] for path in (ROOT / folder).rglob("*.py"))
        yield from drawn(generator, count, [(path, of_python) for path in files], most=1)


def drawn(generator: random.Random, count: int, files: list, most: int) -> Iterator[Mutant]:
    """Draw mutants, each place with the same probability, at most so many of a file."""
    of = {path: list(kinds(path.relative_to(ROOT).as_posix(), path.read_text("utf-8"))) for path, kinds in files}
    places = [(path, mutant) for path, mutants in of.items() for mutant in mutants]
    generator.shuffle(places)
    taken: dict[Path, int] = {}
    for path, mutant in places:
        if count and taken.get(path, 0) < most:
            taken[path] = taken.get(path, 0) + 1
            count -= 1
            yield mutant


# ---- trying ----------------------------------------------------------------------------------------------------------


def applied(mutant: Mutant, text: str) -> str:
    """Give the text with the mutant in it. Raises ValueError where its place is gone."""
    changes = of_python if mutant.file.endswith(".py") else of_model
    places = [other for other in changes(mutant.file, text) if other[3:] == mutant[3:]]
    if not places:
        raise ValueError("the place is gone")
    place = min(places, key=lambda one: (abs(one.line - mutant.line), abs(one.column - mutant.column)))
    source, before = text.encode(), mutant.before.encode()
    start = sum(map(len, source.splitlines(keepends=True)[: place.line - 1])) + place.column - 1
    return (source[:start] + mutant.after.encode() + source[start + len(before) :]).decode()


def nearest(mutant: Mutant, tree: Path) -> list[str]:
    """Name the test files that mention the mutant's module or model, those first that do most: the likely ones."""
    word = Path(mutant.file).stem if mutant.file.endswith(".bpmn") else Path(mutant.file).with_suffix("").as_posix()
    words = {word, word.replace("/", "."), ".".join(word.split("/")[:-1]) + " import"}
    counts = {path: sum(map(path.read_text("utf-8").count, words)) for path in (tree / "tests").rglob("test_*.py")}
    return [str(path.relative_to(tree)) for path, count in sorted(counts.items(), key=lambda it: -it[1]) if count][:12]


def killer(mutant: Mutant, tree: Path, arguments: list[str]) -> str:
    """Run the tests in a tree with the mutant: give the first that fails, or nothing."""
    path = tree / mutant.file
    text = path.read_text("utf-8")
    path.write_text(applied(mutant, text), "utf-8")
    environment = os.environ | {"PYTHONPATH": str(tree)}
    options = [word for word in arguments if not word.startswith("tests")]
    try:
        for tests in (nearest(mutant, tree), [word for word in arguments if word.startswith("tests")] or ["tests"]):
            command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *options, *tests]
            done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
            if done.returncode not in (0, 5):
                failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
                return failed[1] if failed else f"exit code {done.returncode}"
    finally:
        path.write_text(text, "utf-8")
    return ""


def run(mutants: list[Mutant], arguments: list[str]) -> int:
    """Try mutants, and print of each what killed it. Gives how many survived."""
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder, "tree")
        shutil.copytree(
            ROOT, tree, ignore=shutil.ignore_patterns(".venv*", ".git", "out", "__pycache__", ".mypy_cache")
        )
        for mutant in mutants:
            try:
                by = killer(mutant, tree, arguments)
            except ValueError as error:
                print(f"not tried ({error}): {mutant}", flush=True)
                continue
            survived += not by
            print(f"{f'killed by {by}' if by else 'SURVIVED'}: {mutant}", flush=True)
    print(f"{len(mutants) - survived} of {len(mutants)} killed")
    return survived


def main() -> int:
    """Draw or run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    drawing = commands.add_parser("draw")
    drawing.add_argument("rooms", nargs="*", metavar="ROOM:COUNT", help=", ".join(ROOMS))
    drawing.add_argument("--seed", type=int, default=1)
    drawing.add_argument("--missions", type=int, default=0, metavar="COUNT")
    running = commands.add_parser("run")
    running.add_argument("list", type=Path)
    running.add_argument("arguments", nargs="*", metavar="ARGUMENT", help="of pytest, after --")
    arguments = parser.parse_args()
    if arguments.command == "draw":
        rooms = {room: int(count) for room, _, count in (word.partition(":") for word in arguments.rooms)}
        print(*draw(arguments.seed, arguments.missions, rooms), sep="\n")
        return 0
    lines = arguments.list.read_text("utf-8").splitlines()
    return int(bool(run([parsed(line) for line in lines if line and not line.startswith("#")], arguments.arguments)))


if __name__ == "__main__":
    sys.exit(main())
