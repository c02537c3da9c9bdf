"""A Sphinx extension: what pages have for any reader of Markdown becomes navigation, pages and drawings of the site.

- The lists of links in the index and the cookbook are the navigation.
- A comment asks for a reference, which `reference` generates from the code.
- A comment says where `run_pages` shows the run of an example.
- A link to another file of the repository, or to a folder, leads to a page that shows it; a model is drawn.
- A Mermaid flowchart of nodes in subgraphs is a column of boxes, which no script has to draw.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from html import escape
from pathlib import Path

from docutils import nodes
from reference import generate
from run_pages import marked
from sphinx.application import Sphinx

from fame.bpmn.draw.diagram import draw
from fame.bpmn.reader import read
from fame.errors import ModelError

ROOT = Path(__file__).parent.parent
PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{name}</title>
<style>:root {{ color-scheme: light dark }} body {{ margin: 1rem; font-family: sans-serif }} pre {{ overflow-x: auto }}
:target {{ background: #fc08; scroll-margin-top: 4rem }}
svg {{ max-width: 100%; height: auto; background: white }}</style>
<p><a href="{home}">FAME</a> / {name}{run}</p>
{body}
</html>
"""


def add_navigation(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put the pages that the index and the cookbook link to below them, in the order of the links."""
    if docname == "docs/index":
        sections = [part.partition("\n") for part in source[0].split("\n## ")[1:]]
        source[0] += "".join(toctree(text, f":caption: {title}") for title, _, text in sections)
    elif docname == "docs/cookbook":
        source[0] += toctree("\n".join(re.findall(r"\(.*?/README\.md\)", source[0])))


def add_reference(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put in what the page has a comment for."""
    whole = generate(source[0])
    if whole != source[0]:
        source[0] = whole
        app.env.note_reread()  # the code may change without the page


def mark_runs(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put marks where `run_pages` shows the runs of examples."""
    source[0] = marked(docname, source[0])


def toctree(text: str, *options: str) -> str:
    """The directive for all pages that a text links to."""
    pages = re.findall(r"\(([^()]*)\.md\)", text)
    return "\n".join(["\n\n```{toctree}", ":hidden:", *options, "", *pages, "```\n"])


def show_linked_files(app: Sphinx, docname: str, source: list[str]) -> None:
    """Let links to files that are no pages lead to the pages that `write_files` makes of them."""
    here = (ROOT / docname).parent

    def link(found: re.Match[str]) -> str:
        path = Path(os.path.normpath(here / found[1]))
        if path.suffix in (".md", ".svg", ".png", ".gif") or not path.exists():
            return found[0]
        files.setdefault(str(path.relative_to(ROOT)), docname)
        return f"](repository:{os.path.relpath(address(path), here)}{found[2] or ''})"

    files: dict[str, str] = app.env.__dict__.setdefault("linked_files", {})
    source[0] = re.sub(r"\]\(([^()#:]+)(#[^()]*)?\)", link, source[0])


def address(path: Path) -> Path:
    """The page of a file or folder."""
    return path / "index.html" if path.is_dir() else path.with_name(f"{path.name}.html")


def write_files(app: Sphinx, failure: Exception | None) -> None:
    """Write the pages of the files and folders that are linked to, and of what is in these folders."""
    todo = [ROOT / name for name in app.env.__dict__.get("linked_files", ())]
    while todo and failure is None:
        path = todo.pop()
        page = Path(app.outdir) / address(path).relative_to(ROOT)
        if path.is_dir():
            inside = sorted(each for each in path.iterdir() if not each.name.startswith((".", "__")))
            todo += inside
            names = [(os.path.relpath(address(each), path), each.name) for each in inside]
            body = "".join(f'<p><a href="{escape(link)}">{escape(name)}</a></p>\n' for link, name in names)
        else:
            body = content(path)
        page.parent.mkdir(parents=True, exist_ok=True)
        home = os.path.relpath(ROOT / "docs" / "index.html", address(path).parent)
        run = f" <!-- run {path.stem} -->" if path.parent == ROOT / "examples" and path.suffix == ".yaml" else ""
        page.write_text(
            PAGE.format(name=escape(str(path.relative_to(ROOT))), home=home, run=run, body=body), encoding="utf-8"
        )


def content(path: Path) -> str:
    """A file as HTML: a model as its drawing, else the text, with an anchor at each function and class."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return "<p>This file is not text.</p>"
    if path.suffix == ".bpmn":
        with suppress(ModelError):  # it has no diagram, or a test has it because it is wrong
            return draw(read(path))
    anchored = re.sub(r"^(def|class) (\w+)", r'\1 <b id="\2">\2</b>', escape(text, quote=False), flags=re.MULTILINE)
    return f"<pre>{anchored}</pre>"


def draw_flowcharts(app: Sphinx, document: nodes.document) -> None:
    """Replace Mermaid flowcharts by boxes: a row for each subgraph, with its title and its nodes."""
    for block in list(document.findall(lambda node: isinstance(node, nodes.literal_block))):
        if block.get("language") == "mermaid":
            rows = re.findall(r'subgraph \w+ \["(.*?)"\]\n(.*?)\n *end\b', block.astext(), re.DOTALL)
            boxes = "".join(f"<div><b>{escape(title)}</b>{labels(inside)}</div>" for title, inside in rows)
            block.replace_self(nodes.raw("", f'<div class="layers">{boxes}</div>', format="html"))


def labels(subgraph: str) -> str:
    """The nodes of a subgraph as HTML."""
    return "".join(f"<span>{escape(label)}</span>" for label in re.findall(r'\["(.*?)"\]', subgraph))


def setup(app: Sphinx) -> dict[str, int]:
    """Connect the functions to the events of a build."""
    app.connect("source-read", add_navigation)
    app.connect("source-read", add_reference)
    app.connect("source-read", mark_runs)
    app.connect("source-read", show_linked_files)
    app.connect("doctree-read", draw_flowcharts)
    app.connect("build-finished", write_files)
    return {"env_version": 1}  # of what pages are kept as between builds
