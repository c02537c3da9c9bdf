"""``fame new`` and ``fame demo``: write a project, and run one."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

from fame.cli import project
from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json
from fame.errors import ConfigError
from fame.text import suggestion

_NAMED = re.compile(r"[\w./-]+\.(?:bpmn|yaml|py|skops|csv)\b")
"""What looks like the path of a file in the text of another."""
_MADE = shutil.ignore_patterns("__pycache__", ".pytest*")
DEMO = "ground_vehicles"


def add_new(commands: Commands) -> None:
    parser = command(
        commands, "new", run_new,
        examples=("fame new hospital", "fame new --from warehouse depot", "fame new dock --from timeout_and_retry"),
    )  # fmt: skip
    parser.add_argument("name", nargs="?", metavar="NAME", help="name of the project, and of its new folder")
    parser.add_argument(
        "--from", dest="source", nargs="+", metavar="NAME",
        help="copy an example of FAME, or a pattern of its cookbook, with models and tests, instead; "
        "the word example or cookbook may come before the name, and the name of the project after it",
    )  # fmt: skip
    add_json(parser)


def add_demo(commands: Commands) -> None:
    command(commands, "demo", run_demo, examples=("fame demo",))


def run_new(arguments: Namespace) -> int:
    """Write the project and say what to do next."""
    source, name = list(arguments.source or ("",)), arguments.name
    if source[0] in ("example", "cookbook") and len(source) > 1:
        del source[0]
    if name is None and len(source) == 2:  # fame new --from warehouse depot
        name = source.pop()
    if len(source) > 1:
        known = suggestion(source[0], ["example", "cookbook"])
        raise ConfigError(f"--from: expected a name, as in --from example warehouse, got {source[0]!r}; {known}")
    (example,) = source
    name = name or example
    if not name:
        raise ConfigError("expected a name for the project, as in fame new hospital")
    outer = None if arguments.no_project else project.find(Path.cwd())
    if outer is not None:
        text = "is a project already: add scenarios to it, or go to a folder outside; --no-project nests them"
        raise ConfigError(text, file=str(outer))
    files = write(name, example)
    if arguments.json:
        print_json({"status": "completed", "folder": name, "files": list(map(str, files))})
    else:
        print(*(f"{name}/{file}" for file in files), sep="\n")
        print(f"\nnext: cd {name}\n      fame check\n      fame test\n      fame run --log out/run.mcap")
        print("      fame view out/run.mcap")
        print('in git: git config diff.bpmn.textconv "fame diff --textconv"')
    return 0


def run_demo(arguments: Namespace) -> int:
    """Write the project, unless it is there, and run it."""
    from fame.cli import main
    from fame.imports import require

    require("pymunk", "matplotlib", "PIL", "resvg_py")
    if not Path(DEMO, project.FILE).is_file():
        write(DEMO, DEMO)
    out = f"{DEMO}/out/run"
    forms = ("--picture", "png"), ("--animate", "gif"), ("--log", "mcap"), ("--log", "xes")
    outputs = [f"{option}={out}.{ending}" for option, ending in forms]
    code = main(["run", "--no-project", f"{DEMO}/examples/{DEMO}.yaml", *outputs])
    print(f"\n{out}.png, {out}.gif, {out}.xes\nnext: fame view {out}.mcap\n      cd {DEMO}; fame test")
    return code


def write(name: str, example: str = "") -> list[Path]:
    """Write a project to a new folder of the current one: that of ``fame new``, or an example. Gives its files.

    Raises ConfigError for an invalid name, or one that is taken. A failure leaves nothing behind.
    """
    from fame.bpmn.library import BUILT_IN

    home = BUILT_IN[0].parent.parent / "examples"
    if not re.fullmatch(r"\w[\w.-]*", name):
        right = re.sub(r"[^\w.-]+", "_", Path(name).name).strip("_.-") or "hospital"
        raise ConfigError(f"expected a name of letters, digits, _ and -, such as {right}, got {name!r}")
    folder = Path(name)
    if folder.is_dir() and any(folder.iterdir()):
        raise ConfigError("expected a new or an empty folder: this one has files; choose another name", file=name)
    if os.path.lexists(folder) and not folder.is_dir():
        raise ConfigError("expected the name of a new folder: there is a file of this name", file=name)
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{name}-", dir="."))
    except OSError as error:
        text = f"the folder {Path.cwd()} cannot be written ({error.strerror}): change to one of yours"
        raise ConfigError(text, file=name) from None
    try:
        _fill(made, name, example, home)
        made.chmod(0o755)  # as other new folders; a temporary one is private
        made.rename(folder)
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        raise
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())


def _fill(made: Path, name: str, example: str, home: Path) -> None:
    """Write the files of a project to a folder."""
    from fame.check.element_templates import templates, write as as_text
    from fame.check.library import behaviours

    shutil.copytree(home / "project", made, dirs_exist_ok=True, ignore=_MADE)
    file, scenario = made / project.FILE, f"examples/{example}.yaml"
    text = file.read_text(encoding="utf-8").replace("name: project", f'name: "{name}"')
    patterns = {path.parent.name: path.parent for path in (home / "cookbook").glob("*/mission.bpmn")}
    if example:
        examples = {path.stem for path in home.glob("*.yaml") if "\nmodel: " in path.read_text(encoding="utf-8")}
        if example not in examples | patterns.keys():
            raise ConfigError(f"there is no example {example!r}; {suggestion(example, sorted(examples | {*patterns}))}")
        for old in ("mission.bpmn", "mission.yaml", "tests/test_mission.py"):
            (made / old).unlink()
        (made / "tests").rmdir()
    if example in patterns:
        shutil.copytree(patterns[example], made, dirs_exist_ok=True, ignore=_MADE)
        text = text if (made / "mission.yaml").is_file() else text.replace("[mission.yaml]", "[mission.bpmn]")
    elif example:
        needed = sorted(_needed(home / f"{example}.yaml"))
        if any(path.suffix == ".skops" or "\nClassifiers:" in path.read_text("utf-8") for path in needed):
            workflow = made / ".github" / "workflows" / "mission.yml"
            workflow.write_text(workflow.read_text("utf-8").replace("[sim,test]", "[sim,ml,test]"), "utf-8")
        for path in needed:
            target = made / str(path.relative_to(home.parent)).replace("models/monitoring/", "models/", 1)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        text = text.replace("[mission.yaml]", f"[{scenario}]").replace("[tests]", "[examples/tests]")
    file.write_text(text, encoding="utf-8")
    folder = made / ".camunda" / "element-templates"
    folder.mkdir(parents=True)
    for kind, found in templates(behaviours([])).items():
        (folder / f"{kind}.json").write_text(as_text(found), encoding="utf-8")


def _needed(scenario: Path) -> set[Path]:
    """The files of an example: the tests of its model, and all that these and the scenario name and call."""
    root = scenario.parent.parent
    models = {f'"{path.relative_to(root)}"' for path in _named(scenario, root) if path.suffix == ".bpmn"}
    tests = (root / "examples" / "tests").glob("*.py")
    left = [scenario, *(test for test in tests if any(model in test.read_text(encoding="utf-8") for model in models))]
    found = set[Path]()
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += _named(path, root)
    return found


def _named(path: Path, root: Path) -> Iterator[Path]:
    """The files of FAME that the text of a file names, those of the processes that it calls, and the configurations of
    the built-in ones, to be changed."""
    if path.suffix not in (".bpmn", ".yaml", ".py"):
        return
    yield from _in_text(path, root)
    if path.suffix == ".bpmn":
        from fame.bpmn.library import BUILT_IN, Library
        from fame.bpmn.reader import read

        definitions = read(path)
        for process in definitions.processes:
            for home, _ in Library().closure(definitions, process):
                if home.path is None:
                    continue
                if home.path.parent in BUILT_IN:
                    yield from (named for named in _in_text(home.path, root) if named.suffix == ".yaml")
                else:
                    yield home.path


def _in_text(path: Path, root: Path) -> Iterator[Path]:
    """The files of FAME that the text of a file names."""
    for word in _NAMED.findall(path.read_text(encoding="utf-8")):
        named = Path(os.path.normpath((root if path.suffix == ".py" else path.parent) / word))
        if named.is_file() and named.is_relative_to(root):
            yield named
