"""The layers of the packages (docs/architecture.md): allowed imports, and what start-up may load."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest
from bpmn_text import process
from domains import PROCESSES

from fame import rooms
from fame.rooms import room_of

ROOT = Path(__file__).parent.parent
LAYERS = (
    (
        "fame.bpmn",
        "fame.layout",
        "fame.closing",
        "fame.config",
        "fame.clock",
        "fame.iso8601",
        "fame.errors",
        "fame.cpython",
        "fame.dataclasses",
        "fame.gc_tuning",
        "fame.randomness",
        "fame.rooms",
        "fame.imports",
        "fame.intervals",
        "fame.fast_json",
        "fame.text",
        "fame.version",
        "fame.worker",
    ),
    ("fame.engine", "fame.middleware", "fame.properties", "fame.scripting"),
    ("fame.robot",),
    ("fame.deploy", "fame.monitor", "fame.check", "fame.simulation", "fame.log", "fame.mining", "fame.fleet"),
    ("sim2d", "robots"),
    ("fame.scenario", "fame.campaign", "fame.testing", "fame.view", "fame.edit"),
    ("fame.cli", "fame", "fame.__main__"),
)
LAYER = {package: layer for layer, packages in enumerate(LAYERS) for package in packages}
HEAVY = {
    "PIL",
    "cyclonedds",
    "lxml",
    "matplotlib",
    "mcap",
    "numpy",
    "orjson",
    "onnx",
    "onnxruntime",
    "pymunk",
    "quickjs",
    "rclpy",
    "rosbags",
    "sklearn",
    "skops",
    "starlette",
    "uvicorn",
    "xxhash",
    "zenoh",
}


class Import(NamedTuple):
    """One import: importing and imported module, line, and whether it happens when the module is loaded."""

    source: str
    target: str
    line: int
    at_load: bool

    def __str__(self) -> str:
        return f"{self.source}:{self.line} imports {self.target}"


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for folder in ("fame", "robots", "sim2d") for path in (ROOT / folder).rglob("*.py")}


def statements(tree: ast.AST, at_load: bool = True) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, at_load
            continue
        if isinstance(node, ast.expr):  # has no statements
            continue
        for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        yield from statements(node, at_load and not for_types and not inside)


def imports_of(module: str) -> Iterator[Import]:
    for node, at_load in statements(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        else:
            assert node.level == 0, f"{module}:{node.lineno}: imports here name the whole module"
            whole = [f"{node.module}.{alias.name}" for alias in node.names]
            targets = [name if name in MODULES else str(node.module) for name in whole]
        for target in targets:
            yield Import(module, target, node.lineno, at_load)


@cache
def imports() -> list[Import]:
    """All imports of the packages."""
    return [item for module in MODULES for item in imports_of(module)]


def package_of(module: str) -> str:
    """``fame.bpmn`` of ``fame.bpmn.reader``, ``sim2d`` of ``sim2d.world``."""
    parts = module.split(".")
    return ".".join(parts[:2] if parts[0] == "fame" else parts[:1])


def ours(module: str) -> bool:
    return module.split(".")[0] in ("fame", "robots", "sim2d")


def test_every_module_has_its_layer() -> None:
    assert {package_of(module) for module in MODULES} - LAYER.keys() == set()


def test_imports_run_downwards_only() -> None:
    own = [item for item in imports() if ours(item.target) and package_of(item.source) != "fame"]
    upwards = [str(item) for item in own if LAYER[package_of(item.target)] > LAYER[package_of(item.source)]]
    assert upwards == []
    assert len(own) > 100  # or nothing was looked at


def test_packages_import_each_other_in_one_direction() -> None:
    pairs = {(package_of(item.source), package_of(item.target)) for item in imports() if ours(item.target)}
    graph = {name: {target for source, target in pairs if source == name != target} for name in LAYER}
    del graph["fame"], graph["fame.__main__"]  # the package itself attaches the names of its packages
    assert list(TopologicalSorter(graph).static_order())


def test_the_core_imports_no_room() -> None:
    into = [item for item in imports() if room_of(item.target) not in ("", room_of(item.source))]
    assert [str(item) for item in into if not room_of(item.source)] == []
    assert {room_of(item.target) for item in into} >= {"explore", "monitor", "ros"}  # or nothing was looked at


def test_the_core_stays_small_enough_to_be_known_as_a_whole() -> None:
    core = [path for module, path in MODULES.items() if not room_of(module)]
    assert sum(path.read_text("utf-8").count("\n") for path in core) <= 62_000, "what of it is a room?"


def places(table: object) -> Iterator[str]:
    """The places ``module:Name`` in tables of `fame.rooms`."""
    if isinstance(table, str):
        yield from [table] if re.fullmatch(r"[\w.]+:\w+", table) else []
    elif isinstance(table, Mapping | tuple):
        for value in table.values() if isinstance(table, Mapping) else table:
            yield from places(value)


def test_what_the_tables_of_rooms_name_is_there() -> None:
    found = [place for table in vars(rooms).values() for place in places(table)]
    assert len(found) > 60
    for module, _, name in (place.partition(":") for place in found):
        tree = ast.parse(MODULES[module].read_text("utf-8"))
        assert name in {name for node in tree.body for name in bound(node)}, f"{module}:{name}"
    assert {module for room in rooms.ROOMS.values() for module in room.modules} <= MODULES.keys()


def bound(node: ast.stmt) -> Iterator[str]:
    """The names that a statement of a module defines or imports."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.ImportFrom):
        yield from (alias.asname or alias.name for alias in node.names)


def test_the_engine_knows_nothing_but_the_model() -> None:
    allowed = {"fame.bpmn.model", "fame.dataclasses", "fame.errors", "fame.text"}
    outside = [item for item in imports() if package_of(item.source) == "fame.engine" != package_of(item.target)]
    assert [str(item) for item in outside if ours(item.target) and item.target not in allowed] == []
    foreign = [item for item in outside if not ours(item.target)]
    assert [str(item) for item in foreign if item.target.split(".")[0] not in sys.stdlib_module_names] == []


def test_robots_register_themselves_and_are_imported_by_nobody() -> None:
    users = {str(item) for item in imports() if package_of(item.target) == "robots" != package_of(item.source)}
    tools_of_an_arm = {
        user for user in users if user.startswith("fame.cli.monitor.")
    }  # not a robot: its task and envelope
    assert users - tools_of_an_arm == set()
    assert {package_of(item.source) for item in imports() if package_of(item.target) == "sim2d"} == {
        "sim2d", "robots", "fame.scenario", "fame.campaign", "fame.cli"
    }  # fmt: skip


def test_dataclasses_are_declared_without_compiling_them() -> None:
    declaring = {item.source for item in imports() if item.target == "dataclasses" and item.at_load}
    texts = {name: MODULES[name].read_text(encoding="utf-8") for name in declaring}
    assert [name for name, text in texts.items() if "@dataclass" in text] == []


def test_only_reader_and_writer_know_xml() -> None:
    assert {package_of(item.source) for item in imports() if item.target.split(".")[0] == "lxml"} == {"fame.bpmn"}


def test_the_command_line_imports_heavy_parts_where_it_uses_them() -> None:
    loaded = [
        item for item in imports() if item.at_load and package_of(item.source) == "fame.cli" and ours(item.target)
    ]
    light = {"fame.cli", "fame.dataclasses", "fame.errors", "fame.rooms", "fame.text"}
    assert {package_of(item.target) for item in loaded} == light


def test_an_engine_without_a_process_has_loaded_nothing_that_only_a_process_needs() -> None:
    pytest.importorskip("cyclonedds")
    code = (
        "from fame.deploy import EngineNode\n"
        "from fame.middleware.dds import DdsMiddleware, DdsScheduler\n"
        f"scheduler = DdsScheduler(); middleware = DdsMiddleware(scheduler, domain={PROCESSES})\n"
        "engine = EngineNode('REX', scheduler=scheduler, middleware=middleware)\n"
        "scheduler.run(scheduler.now + 10**8); engine.close(); middleware.close()\n"
        "import sys; print(*{name.split('.')[0] for name in sys.modules}, *sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"fame", "cyclonedds"} <= loaded
    assert loaded & {"fame.bpmn.model", "fame.engine", "fame.scripting", "fame.robot.node", "fame.check"} == set()
    assert loaded & {"rosbags", "numpy", "yaml", "lxml"} == set()


def test_the_command_of_an_engine_loads_no_interpreter_before_there_is_a_process() -> None:
    code = (
        "import fame.cli.engine, fame.scripting.budget\n"
        "from fame.deploy import EngineNode\n"
        "from fame.deploy.loading import preload\n"
        "from fame.scenario import serve\n"
        "import sys; print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"fame.deploy.engine_node", "fame.scenario.process"} <= loaded
    late = {"fame.bpmn.model", "fame.check", "fame.engine.interpreter", "fame.robot.node", "fame.scripting.languages"}
    assert loaded & {*late, "decimal", "subprocess"} == set()


@pytest.mark.long_but("not*", "until*")
@pytest.mark.parametrize(
    ("engines", "steps", "number"),
    [(20, 9, 0), (2, 9, 5), (2, 2, 2)],
    ids=["not while many start", "all", "until a process comes"],
)
def test_an_engine_that_waits_loads_what_its_first_process_will_need(engines: int, steps: int, number: int) -> None:
    code = (
        "from fame.clock import SECOND, Scheduler; from fame.deploy.loading import preload\n"
        f"scheduler, answers = Scheduler(), iter([True] * {steps} + [False])\n"
        f"preload(scheduler, lambda: next(answers), lambda: {engines}); scheduler.run(29 * SECOND // 10)\n"
        "import sys; print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    wanted = ["fame.bpmn.reader", "fame.check", "fame.robot.node", "rosbags", "numpy"]
    loaded = set(done.stdout.split())
    assert [name for name in wanted if name in loaded] == wanted[:number]


@pytest.mark.parametrize(
    "code",
    [
        "import fame",
        "import fame.cli; fame.cli.parser().format_help()",
        "import sys, runpy; sys.argv[1:] = ['--help']\ntry: runpy.run_module('fame')\nexcept SystemExit: pass",
    ],
    ids=["import fame", "parser", "fame --help"],
)
def test_nothing_heavy_is_loaded(code: str) -> None:
    shown = "import sys; print(*{name.split('.')[0] for name in sys.modules}, file=sys.stderr)"
    command = [sys.executable, "-c", f"{code}\n{shown}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert "fame" in loaded
    assert loaded & HEAVY == set()


HELP = {"cli", "errors", "imports", "rooms", "text"}
CHECK = {*HELP, "bpmn", "check", "clock", "config", "dataclasses", "engine", "iso8601", "middleware", "properties",
         "randomness", "robot", "scripting", "worker"}  # fmt: skip
LOADED = {"--help": HELP, "check": CHECK, "run": {*CHECK, "scenario"}}
"""The packages and modules of FAME that a command may load for a process of one task."""
ELSEWHERE = {"lxml", "cython_runtime"}
LATE = {
    *("ctypes", "hashlib", "html", "importlib.metadata", "importlib.resources", "subprocess", "uuid"),
    *("fame.properties.judge", "fame.robot.acknowledged", "fame.scripting.feel", "fame.scripting.javascript"),
}
"""What a process of one task needs none of, and what takes longer to load than the task."""
NO_HELP = {"ast", "dataclasses", "inspect", "random", "shutil", "socket", "tempfile", "tokenize"}
"""What the list of all commands needs none of besides: each takes a twentieth of its time."""


@pytest.mark.long_but("run")
@pytest.mark.parametrize("command", LOADED)
def test_a_command_loads_what_its_process_needs(command: str, tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(process('<startEvent id="s"/>'))
    arguments = [command, *[str(tmp_path / "m.bpmn")] * (command != "--help")]
    code = (
        "import sys; before = set(sys.modules)\nfrom fame.cli import main\n"
        f"try: main({arguments})\nexcept SystemExit: pass\n"
        "print(*set(sys.modules) - before, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    parts = {name.split(".")[1] for name in loaded if name.startswith("fame.")}
    others = {name.split(".")[0] for name in loaded} - set(sys.stdlib_module_names) - {"fame"}
    assert parts <= LOADED[command]
    assert {name for name in others if not name.startswith("_")} <= ELSEWHERE
    assert command != "--help" or not loaded & NO_HELP
    assert not loaded & LATE
