"""Pages: their links lead somewhere, and the site has all of them."""

import ast
import json
import re
import shlex
import sys
import tomllib
from collections import Counter
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from fame.bpmn import read_text
from fame.bpmn.extension_properties import PROPERTIES, THROWS
from fame.cli import NAMES, main, parser, project
from fame.config.loader import read_document
from fame.config.values import entries
from fame.deploy.migration import read_plan
from fame.monitor.anomaly import learning_file
from fame.monitor.pipeline import configuration
from fame.properties.files import read_properties
from fame.scenario import plan
from fame.scenario.settings import read_network
from sim2d import config
from sim2d.robot import BUILT_IN

sys.path.append(str(Path(__file__).parent.parent / "docs"))
from reference import FILES, PACKAGES, generate

ROOT = Path(__file__).parent.parent
PAGES = sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("examples/**/*.md")})
LINK = r"\]\(([^()# ]*)(?:#([^()]*))?\)"
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


every_command = cache(parser)


@cache
def prose(page: Path) -> str:
    """The text of a page without its code blocks."""
    return re.sub(r"^( *)```.*?^\1```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


@cache
def anchors(target: Path) -> set[str]:
    """What a link to a file can name: the headings of a page, functions and classes of a module."""
    if target.suffix == ".py":
        return set(re.findall(r"^(?:def|class) (\w+)", target.read_text(encoding="utf-8"), re.MULTILINE))
    seen: Counter[str] = Counter()
    for heading in re.findall(r"^#+ (.*)$", generate(prose(target)), re.MULTILINE):
        slug = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        seen[slug] += 1
    return {f"{slug}-{number}" if number else slug for slug, count in seen.items() for number in range(count)}


@each_page
def test_links_lead_somewhere(page: Path) -> None:
    for target, anchor in re.findall(LINK, prose(page)):
        if not target.startswith("https://"):
            path = page.parent / target if target else page
            assert path.exists(), target
            assert not anchor or anchor in anchors(path), f"{target}#{anchor}"


@each_page
def test_no_table_is_cut_in_two_by_an_empty_line(page: Path) -> None:
    rows = re.findall(r"^\|.*\n\n(\|.*)\n(?!\| ?-)", prose(page), re.MULTILINE)
    assert rows == []


def test_pages_that_code_names_exist() -> None:
    for path in (path for folder in ("fame", "robots", "sim2d") for path in ROOT.glob(f"{folder}/**/*.py")):
        for name, anchor in re.findall(r"(docs/\w+\.md)(?:#([\w-]+))?", path.read_text(encoding="utf-8")):
            if name != "docs/design.md":  # of rmw_zenoh
                assert (ROOT / name).exists(), (path, name)
                assert not anchor or anchor in anchors(ROOT / name), (path, name, anchor)


def test_the_reference_has_every_command_with_examples_that_parse() -> None:
    page = generate("<!-- generated: commands -->")
    told = re.findall(r"^#+ `fame (\S+)`$", page, re.MULTILINE)
    assert told == [name for name in NAMES if name != "team"]
    assert "| `--middleware local\\|dds\\|zenoh\\|ros` | local (default): everything in one process" in page
    examples = [line for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    assert len(examples) > 100
    for line in examples:
        words = shlex.split(
            re.sub(r"( [>|]|;| &&) .*", "", line.replace("wlan0", "127.0.0.1").replace("eth0", "127.0.0.1")),
            comments=True,
        )
        assert every_command().parse_args(words[1:]).command, line


def test_the_table_of_extension_properties_has_those_that_the_code_reads() -> None:
    read: set[str] = set()
    for path in ROOT.glob("fame/**/*.py"):
        text = path.read_text(encoding="utf-8")
        read.update(re.findall(r"(?:extensions|found)\.take\(\"(\w+)\"", text))
        read.update(re.findall(r"\.properties\.get\(\"(\w+)\"", text))
    told = {name for meanings in PROPERTIES.values() for name in meanings}
    assert {"delivery", "resume", "retry", "outside"} <= read <= told
    assert f"| `to` | {PROPERTIES[THROWS]['to']} |" in generate("<!-- generated: properties -->")


def test_the_python_reference_has_every_public_name_with_its_docstring() -> None:
    page = generate("<!-- generated: python -->")
    listed = re.findall(r"^\| `(\S+)`(?:, `(\S+)`)? \|", (ROOT / "docs" / "python.md").read_text("utf-8"), re.MULTILINE)
    assert {name for names in listed for name in names if name in PACKAGES} == {*PACKAGES}
    told = re.findall(r"^### `(\S+)`$", page, re.MULTILINE)
    assert told == [f"{package}.{name}" for package in PACKAGES for name in import_module(package).__all__]
    assert "run(until: float | None = None) -> Simulation" in page
    assert "| `definitions` | a model, from `fame.read`, or its path |" in page
    assert " at 0x" not in page


def test_the_reference_of_yaml_keys_has_the_tables_of_the_validators_and_no_page_has_a_second_one() -> None:
    page = generate("<!-- generated: keys -->")
    for known in (known for tables in FILES.values() for known in tables.values()):
        assert all(f"| `{key}` | " in page for key in known)
    assert {f"### `type: {name}`" for name in BUILT_IN} <= {*page.splitlines()}
    assert "| `range.max` | 2.0 m; more is +inf |" in page
    heads = [
        (page.name, head)
        for page in PAGES
        if page.name != "yaml_keys.md"
        for head in re.findall(r"^\| (?:key \||parameter \| default).*", prose(page), re.MULTILINE)
    ]
    assert heads == [("view.md", "| key | effect |")]  # of the keyboard


GENERATED_PAGES = (
    "README.md",
    "docs/architecture.md",
    "docs/check_errors.md",
    "docs/check_warnings.md",
    "docs/commands.md",
    "docs/extension_properties.md",
    "docs/feel.md",
    "docs/robot_topics.md",
    "docs/semantics_tables.md",
    "docs/yaml_keys.md",
)


@pytest.mark.parametrize("name", GENERATED_PAGES)
def test_the_reference_in_the_pages_is_that_of_the_code(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    assert text == generate(text, committed=True), "python docs/reference.py writes it"
    assert len(text.partition("<!-- generated")[2].partition("<!-- end -->")[0].split()) > 80


def test_fame_docs_gives_the_address_of_a_page_of_the_site(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("fame.cli.docs._SITE", tmp_path)
    (tmp_path / "docs").mkdir()
    for name in ("index", "semantics"):
        (tmp_path / "docs" / f"{name}.html").touch()
    assert main(["docs", "semantisc", "--no-open"]) == 2
    assert capsys.readouterr().err == "fame: error: unknown page 'semantisc'; did you mean 'semantics'?\n"
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert main(["docs"]) == 0
    assert capsys.readouterr().out == f"file://{tmp_path}/docs/index.html\n"
    assert opened == [f"file://{tmp_path}/docs/index.html"]


def test_without_the_site_fame_docs_prints_the_page_and_why(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("fame.cli.docs._SITE", tmp_path)
    text = (ROOT / "docs" / "semantics.md").read_text("utf-8")
    assert main(["docs", "semantics"]) == 0
    printed = capsys.readouterr()
    assert printed.out == text + "\n"
    assert printed.err.startswith("fame: note: this FAME was built without the site")
    assert main(["docs", "--text", "semantics"]) == 0
    assert capsys.readouterr() == (text + "\n", "")


def test_the_index_lists_every_page() -> None:
    """A page that is in no list of docs/index.md is not in the navigation of the site."""
    index = ROOT / "docs" / "index.md"
    listed = {(index.parent / target).resolve() for target, _ in re.findall(LINK, prose(index))}
    assert sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")} - listed - {index}) == []


# ---- code blocks -----------------------------------------------------------------------------------------------------

BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
OTHERS = {
    "apt cmake colcon dask docker git ip scp sed ssh systemctl": "a program of others",
    "cd cp done export for source text wait": "a word of the shell",
    "python3": "makes a virtual environment",
    "ros2": "another ROS 2 program; make test-ros runs those of FAME",
    "json5": "an extract with comments",
    "js": "a module of the page",
    "twist_mux": "the configuration of another ROS package",
    "patrol.bpmn": "an exception from coverage: the test of fame test reads one",
}
"""Commands, kinds of blocks and first keys that nothing of FAME can read, and why."""
RUN = {"tutorial_monitor.md"}
"""Pages whose commands another test runs in their order, those of the shell included."""


def listed(name: str) -> bool:
    return any(name in names.split() for names in OTHERS)


def command_is_right(line: str) -> bool:
    """Whether one of FAME's own commands is right; False for a program of others, which is listed."""
    ours = re.sub(
        r"^(\S*/fame|ros2 run fame) ", "fame ", line.replace("wlan0", "127.0.0.1").replace("eth0", "127.0.0.1")
    )
    words = shlex.split(re.sub(r" ([>|] .*|&( |$).*)", "", ours), comments=True)
    words = words[words.index("&&") + 1 :] if words[:1] == ["source"] and "&&" in words else words
    match words:
        case ["fame", *arguments]:
            assert every_command().parse_args(arguments).command
        case ["make", target, *_]:
            assert re.search(rf"^{target}:", MAKEFILE, re.MULTILINE)
        case [program] if program.startswith(".ci/"):
            assert (ROOT / program).exists()
        case [program, "-m", module, *arguments] if program.endswith("python"):
            assert import_module(module)
            assert all((ROOT / name).exists() for name in arguments if name.startswith("tests/"))
        case ["python", script, *_] if script.endswith(".py"):
            assert (ROOT / script).exists()
        case [program, "install" | "wheel", *arguments] if program.endswith("pip"):
            extras = re.findall(r"(?:fame-robots|fame|\.)\[([a-z,]+)\]", " ".join(arguments))
            assert {name for each in extras for name in each.split(",")} <= EXTRAS.keys()
        case ["ros2", "launch", "fame", file, *_]:
            assert (ROOT / "launch" / file).exists()
        case _:
            assert listed(re.sub(r"\W.*", "", next(word for word in words if word != "sudo"))), line
            return False
    return True


def yaml_is_right(text: str, folder: Path) -> bool:
    """Whether the validator of a file takes it; False for one that no validator of FAME is for, which is listed."""
    file = folder / "page.yaml"
    file.write_text(text, encoding="utf-8")
    document = read_document(file)
    names = set(document.mapping())
    if "model" in names:
        (folder / document.data["model"]).touch()
        assert plan.read_scenario(file)
    elif names <= {*config.KEYS}:
        assert config.world_config({"size": [100, 100], **document.data})
    elif names == {"network"}:
        assert read_network(document.mapping()["network"])
    elif names <= {"properties", "poses"}:
        assert read_properties(file)
    elif names <= {*configuration.KEYS}:
        parts = document.mapping(configuration.KEYS)  # types that it imports are the reader's
        for port in (port for key in ("Inputs", "Outputs") for port in entries(parts, key).values()):
            assert port.mapping(configuration.PORT_KEYS)
    elif names <= {*learning_file.KEYS}:
        assert document.mapping(learning_file.KEYS)
    elif names <= {*project.KEYS}:
        assert project.read(file)
    elif names <= {"elements", "variables"}:
        assert read_plan(file)
    else:
        assert listed(min(names)), names
        return False
    return True


def test_code_blocks_are_read_by_what_they_are_for_and_at_most_15_percent_are_only_listed(tmp_path: Path) -> None:
    """Commands by their parsers, files by their validators, Python by its compiler."""
    right: list[bool] = []
    for page in PAGES:
        for indent, language, body in BLOCK.findall(page.read_text(encoding="utf-8")):
            text = re.sub(rf"^{indent}", "", body, flags=re.MULTILINE)
            if language == "sh":
                lines = text.replace("\\\n", " ").splitlines()
                right += [
                    command_is_right(line.strip()) or page.name in RUN
                    for line in lines
                    if line.strip()[:1] not in ("", "#")
                ]
            elif language == "yaml":
                right.append(yaml_is_right(text, tmp_path))
            elif language == "python":
                compile(text, str(page), "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
                right.append(True)
            elif language == "json":
                right.append(bool(json.loads(text)))
            elif language == "xml":
                right.append(bool(read_text(text).processes))
            elif language == "toml":
                right.append(bool(tomllib.loads(text)))
            elif language not in ("mermaid", "text"):  # a drawing, what a command prints
                assert listed(language), language
                right.append(False)
    assert right.count(False) <= 0.15 * len(right), f"{right.count(False)} of {len(right)}"


def test_tables_of_performance_say_when_they_were_measured_and_are_at_most_two_releases_old() -> None:
    releases = re.findall(r"^## \[[\d.]+\] - (\S+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    ages = {}
    for page in sorted(ROOT.glob("docs/performance*.md")):
        above, table = "", False
        for number, line in enumerate(page.read_text("utf-8").splitlines(), 1):
            if line.startswith("|") and not table:
                measured = re.fullmatch(r"Measured (\d{4}-\d\d-\d\d), [0-9a-f]{8}:", above)
                assert measured, (
                    f"{page.name}:{number}: above a table stands when and at which revision it was measured"
                )
                ages[f"{page.name}:{number}"] = sum(release > measured[1] for release in releases)
            above, table = line or above, line.startswith("|")
    assert {place: age for place, age in ages.items() if age > 2} == {}
    assert len(releases) >= 3 <= len(ages)
