"""Faults by machine: which of the tests notice that a line is wrong?

A mutant is the source with one place changed: a comparison turned round, a condition negated, `and` for `or`, a number
one more, a call, an assignment, a `raise`, an argument or an entry left out, two statements in the other order, nothing
returned; in a model a flow, a signal, a property or a number. Each is tried in a copy of the tree: the tests that are
likely to notice are run until one fails, then the others, then seeds of `tests.torture`. The diffs of those that
survived come last.

    python -m tests.mutants cover -- tests -m 'not long'                    note which test runs which line
    python -m tests.mutants draw --seed 58 --covered engine:50 robot:50     print a list, a mutant a line
    python -m tests.mutants run --tests 120 --seeds 60 LIST -- tests -m 'not long'     killed by which test, or survived

Without `cover` a file is drawn from once at most, and tests are the likely ones by their texts, then those named. After
it only tests that run the line are tried, the likely ones and the others for `--tests` seconds of processor time each;
a test that does not end within a minute kills, too.
A list is text, `FILE:LINE:COLUMN KIND | before | after`, and can be repeated after the code has moved: of the mutants
that could be drawn with the same texts, the nearest to its line is meant.
``tests/mutants.txt`` was drawn before tests were moved to `make test-long`.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
COVERAGE = ROOT / "out" / "coverage"
LIKELY = 3
"""How many files of tests are tried first."""
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
    encoded = text.encode()
    starts = [0]
    for line in encoded.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def source(node: ast.AST) -> str:  # as ast.get_source_segment, which splits the whole text each time
        first = starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        last = starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        return encoded[first:last].decode()

    def change(node: ast.AST, kind: str, after: str) -> Mutant:
        return Mutant(file, node.lineno, node.col_offset + 1, kind, source(node), after)  # type: ignore[attr-defined]

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
            case ast.Raise() | ast.Delete():
                yield change(node, "left out", "pass")
            case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
                yield change(value, "nothing returned", "None")
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                yield change(node, "not left out", source(operand))
        yield from (change(node, "field left out", without) for without in less(node, source))
        for body in (getattr(node, name, None) for name in ("body", "orelse", "finalbody")):
            for first, second in pairwise(body) if isinstance(body, list) else ():
                if acts(first) + acts(second) > 2:  # else their order can hardly matter
                    both = ast.Expr(first, lineno=first.lineno, col_offset=first.col_offset)
                    both.end_lineno, both.end_col_offset = second.end_lineno, second.end_col_offset
                    yield change(both, "swapped", f"{source(second)}; {source(first)}")


def acts(statement: ast.AST) -> int:
    """Return 2 for a call, 1 for an assignment to a part of something, -2 for all else."""
    match statement:
        case ast.Expr(value=ast.Call()):
            return 2
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.AugAssign(target=ast.Attribute()):
            return 1
    return -2


def less(node: ast.AST, source: Callable[[ast.AST], str]) -> Iterator[str]:
    """Yield the texts of a call, dict or set of names without one of its keyword arguments or entries."""
    match node:
        case ast.Call(keywords=keywords):
            parts = [source(each) for each in keywords]
        case ast.Dict(keys=keys, values=values) if len(keys) > 1 and None not in keys:
            whole = source(node)
            starts = [whole.index(source(key)) for key in keys if key]
            ends = [whole.index(source(value), start) for start, value in zip(starts, values, strict=False)]
            parts = [whole[start:end] + source(value) for start, end, value in zip(starts, ends, values, strict=False)]
        case _:
            return
    whole = source(node)
    for part in parts:
        without = re.sub(rf"(?<=[(\s,{{]){re.escape(part)}\s*(,\s*|(?=[)}}]))", "", whole, count=1)
        if without != whole:
            yield without


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


def draw(seed: int, missions: int, rooms: dict[str, int], *, covered: bool = False) -> Iterator[Mutant]:
    """Mutants of the shipped missions, then of each room, a file at most once; of lines that tests run, any number."""
    generator = random.Random(seed)
    shipped = sorted((ROOT / "models").glob("*.bpmn"))
    yield from drawn(generator, missions, [(path, of_model) for path in shipped], most=len(shipped))
    for room, count in rooms.items():
        files = sorted(path for folder in ROOMS[room] for path in (ROOT / folder).rglob("*.py"))
        yield from drawn(generator, count, [(path, of_run_lines if covered else of_python) for path in files],
                         most=count if covered else 1)  # fmt: skip


def of_run_lines(file: str, text: str) -> Iterator[Mutant]:
    """All changes of a module at lines that a test runs."""
    lines = tests_of(file)
    return (mutant for mutant in of_python(file, text) if lines.get(mutant.line))


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


def tests_of(file: str) -> dict[int, list[str]]:
    """Return the tests that run each line of a module, as `cover` has noted."""
    from coverage import CoverageData

    data = CoverageData(str(COVERAGE))
    data.read()
    noted = data.contexts_by_lineno(str(ROOT / file))
    return {line: [name.partition("|")[0] for name in names if name] for line, names in noted.items()}


def running(mutant: Mutant, tree: Path) -> list[list[str]]:
    """Name the tests that run a mutant's line: those of the likely files, then the others, the most precise first."""
    lines = tests_of(mutant.file)
    last = mutant.line + mutant.before.count("\n")
    tests = dict.fromkeys(test for line in range(mutant.line, last + 1) for test in lines.get(line, ()))
    counts = Counter(test.partition("::")[0] for test in tests)
    mention = [file for file in nearest(mutant, tree) if file in counts]
    order = [*mention, *(file for file, _ in counts.most_common() if file not in mention)]
    by_file = [[test for test in tests if test.partition("::")[0] == file] for file in order]
    return [[*chain(*by_file[:LIKELY])], [*chain(*by_file[LIKELY:])]]


def nearest(mutant: Mutant, tree: Path) -> list[str]:
    """Name the test files that mention the mutant's module or model, those first that do most: the likely ones."""
    word = Path(mutant.file).stem if mutant.file.endswith(".bpmn") else Path(mutant.file).with_suffix("").as_posix()
    words = {word, word.replace("/", "."), ".".join(word.split("/")[:-1]) + " import"}
    counts = {path: sum(map(path.read_text("utf-8").count, words)) for path in (tree / "tests").rglob("test_*.py")}
    return [str(path.relative_to(tree)) for path, count in sorted(counts.items(), key=lambda it: -it[1]) if count][:12]


def killer(mutant: Mutant, tree: Path, arguments: list[str], seconds: float, seeds: float) -> str:
    """Run the tests in a tree with the mutant, then seeds: give the first that fails, or nothing."""
    path = tree / mutant.file
    text = path.read_text("utf-8")
    path.write_text(applied(mutant, text), "utf-8")
    named = [word for word in arguments if word.startswith("tests")] or ["tests"]
    options = [word for word in arguments if not word.startswith("tests")]
    pytest = ["pytest", "-x", "-p", "no:cacheprovider", "-o", "faulthandler_timeout=60"]
    pytest += ["-o", "faulthandler_exit_on_timeout=true", *options]
    noted = COVERAGE.exists() and mutant.file.endswith(".py")
    try:
        for tests in running(mutant, tree) if noted else (nearest(mutant, tree), named):
            done = tests and end_of([*pytest, *tests], tree, seconds if noted else None)
            if done and done.returncode not in (0, 5):
                failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
                return failed[1] if failed else f"exit code {done.returncode}"
        torture = ["tests.torture", "--seconds", str(seeds), "--seeds", "1:100000"]
        if seeds and (done := end_of(torture, tree, 5 * seeds)) and done.returncode:
            return next(iter(re.findall("^seed [0-9]+", done.stdout, re.MULTILINE)), "the simulation")
    finally:
        path.write_text(text, "utf-8")
    return ""


def end_of(module: list[str], tree: Path, seconds: float | None) -> subprocess.CompletedProcess[str] | None:
    """Run a module in a tree; None if it has not ended after so many seconds of processor time."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tree), *filter(None, [os.environ.get("PYTHONPATH")])])
    }
    limit = [] if seconds is None else ["prlimit", f"--cpu={round(seconds)}:{round(seconds) + 1}"]
    command = [*limit, sys.executable, "-m", *module]
    with tempfile.TemporaryFile("w+") as output:
        started = subprocess.Popen(command, cwd=tree, env=environment, stdout=output, stderr=output, process_group=0)
        try:
            code = started.wait()
        finally:
            with suppress(ProcessLookupError):
                os.killpg(started.pid, signal.SIGKILL)  # also what it has started
            started.wait()
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            return None
        output.seek(0)
        return subprocess.CompletedProcess(command, code, output.read())


def run(mutants: list[Mutant], arguments: list[str], seconds: float, seeds: float) -> int:
    """Try mutants, and print of each what killed it, then the diffs of the others. Gives how many survived."""
    survived = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder, "tree")
        shutil.copytree(
            ROOT, tree, ignore=shutil.ignore_patterns(".venv*", ".git", "out", "__pycache__", ".mypy_cache")
        )
        for mutant in mutants:
            try:
                by = killer(mutant, tree, arguments, seconds, seeds)
            except ValueError as error:
                print(f"not tried ({error}): {mutant}", flush=True)
                continue
            survived += [] if by else [mutant]
            print(f"{f'killed by {by}' if by else 'SURVIVED'}: {mutant}", flush=True)
    for mutant in survived:
        text = (ROOT / mutant.file).read_text("utf-8")
        both = [each.splitlines() for each in (text, applied(mutant, text))]
        print(*difflib.unified_diff(*both, mutant.file, "mutant", lineterm=""), sep="\n")
    print(f"{len(mutants) - len(survived)} of {len(mutants)} killed")
    return len(survived)


def cover(arguments: list[str]) -> int:
    """Run tests, and note which lines of the rooms each runs. Gives the exit code of pytest."""
    COVERAGE.parent.mkdir(exist_ok=True)
    settings = COVERAGE.with_suffix(".rc")
    sources = "".join(f"\n  {folder}" for folders in ROOMS.values() for folder in folders)
    settings.write_text(f"[run]\nsource ={sources}\ndata_file = {COVERAGE}\n", "utf-8")
    options = ["--cov", f"--cov-config={settings}", "--cov-context=test", "--cov-report="]
    return subprocess.run([sys.executable, "-m", "pytest", *options, *arguments], cwd=ROOT, check=False).returncode


def main() -> int:
    """Draw or run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    drawing = commands.add_parser("draw")
    drawing.add_argument("rooms", nargs="*", metavar="ROOM:COUNT", help=", ".join(ROOMS))
    drawing.add_argument("--seed", type=int, default=1)
    drawing.add_argument("--missions", type=int, default=0, metavar="COUNT")
    drawing.add_argument("--covered", action="store_true", help="of lines that a test runs, as `cover` has noted")
    running = commands.add_parser("run")
    running.add_argument("list", type=Path)
    running.add_argument(
        "--tests", type=float, default=120, metavar="S", help="processor time of the tests of a line (120)"
    )
    running.add_argument("--seeds", type=float, default=0, metavar="S", help="for so long seeds, after the tests (0)")
    for each in (running, commands.add_parser("cover")):
        each.add_argument("arguments", nargs="*", metavar="ARGUMENT", help="of pytest, after --")
    arguments = parser.parse_args()
    if arguments.command == "draw":
        rooms = {room: int(count) for room, _, count in (word.partition(":") for word in arguments.rooms)}
        print(*draw(arguments.seed, arguments.missions, rooms, covered=arguments.covered), sep="\n")
        return 0
    if arguments.command == "cover":
        return cover(arguments.arguments)
    lines = arguments.list.read_text("utf-8").splitlines()
    mutants = [parsed(line) for line in lines if line and not line.startswith("#")]
    return int(bool(run(mutants, arguments.arguments, arguments.tests, arguments.seeds)))


if __name__ == "__main__":
    sys.exit(main())
