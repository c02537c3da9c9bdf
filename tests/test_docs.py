"""Pages: their links lead somewhere, and the site has all of them."""

import re
import shlex
import sys
from collections import Counter
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from fame.bpmn.extension_properties import PROPERTIES, THROWS
from fame.cli import COMMANDS, main, parser
from sim2d.robot import BUILT_IN

sys.path.append(str(Path(__file__).parent.parent / "docs"))
from reference import FILES, PACKAGES, generate

ROOT = Path(__file__).parent.parent
PAGES = sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("examples/**/*.md")})
LINK = r"\]\(([^()# ]*)(?:#([^()]*))?\)"
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


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
    for heading in re.findall(r"^#+ (.*)$", prose(target), re.MULTILINE):
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


def test_pages_that_code_names_exist() -> None:
    for path in (path for folder in ("fame", "robots", "sim2d") for path in ROOT.glob(f"{folder}/**/*.py")):
        for name, anchor in re.findall(r"(docs/\w+\.md)(?:#([\w-]+))?", path.read_text(encoding="utf-8")):
            if name != "docs/design.md":  # of rmw_zenoh
                assert (ROOT / name).exists(), (path, name)
                assert not anchor or anchor in anchors(ROOT / name), (path, name, anchor)


def test_the_reference_has_every_command_with_examples_that_parse() -> None:
    page = generate("<!-- generated: commands -->")
    told = re.findall(r"^#+ `fame (\S+)`$", page, re.MULTILINE)
    assert told == [name for name in COMMANDS if name != "team"]
    assert "| `--middleware local\\|dds\\|zenoh\\|ros` | local (default): everything in one process" in page
    examples = [line for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    assert len(examples) > 100
    for line in examples:
        words = shlex.split(re.sub(r"( [>|]|;| &&) .*", "", line.replace("wlan0", "127.0.0.1")), comments=True)
        assert parser().parse_args(words[1:]).command, line


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


def test_the_reference_of_yaml_keys_has_the_tables_of_the_validators_and_pages_name_no_others() -> None:
    page = generate("<!-- generated: keys -->")
    for known in (known for tables in FILES.values() for known in tables.values()):
        assert all(f"| `{key}` | " in page for key in known)
    assert {f"### `type: {name}`" for name in BUILT_IN} <= {*page.splitlines()}
    assert "| `range.max` | 2.0 m |" in page
    for name, known in (("scenarios", FILES["Scenarios"][""]), ("world", FILES["Worlds"][""])):
        (rows,) = re.findall(r"\| key \|.*\n\| ---.*\n((?:\|.*\n)+)", (ROOT / "docs" / f"{name}.md").read_text("utf-8"))
        assert set(re.findall(r"`(\w+)`", "".join(row.split("|")[1] for row in rows.splitlines()))) <= {*known}


def test_fame_docs_gives_the_address_of_a_page_of_the_site(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("fame.cli.docs._SITE", tmp_path)
    assert main(["docs", "--no-open"]) == 2
    assert capsys.readouterr().err == f"fame: error: {tmp_path}: the site is not built; make docs builds it\n"
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


def test_the_index_lists_every_page() -> None:
    """A page that is in no list of docs/index.md is not in the navigation of the site."""
    index = ROOT / "docs" / "index.md"
    listed = {(index.parent / target).resolve() for target, _ in re.findall(LINK, prose(index))}
    assert sorted({*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")} - listed - {index}) == []
