"""Make the site to publish: that of `fame docs`, and each example and pattern of the cookbook as a page of its run.

    python docs/run_pages.py [--site FOLDER] [--to FOLDER]

`make docs` calls it. The pages are kept in out/runs, by a digest of what they are made of: without a change of FAME,
the models or the examples, none is made again. Wheels have the site without them.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import time
from functools import partial
from hashlib import sha256
from html import escape
from pathlib import Path

from fame.log import About, logging_to
from fame.scenario import Scenario
from fame.view.page_file import write_recording

ROOT = Path(__file__).parent.parent
CODE = ("fame", "robots", "sim2d", "models", "examples")
SITE = ROOT / "fame" / "site"
KEPT = ROOT / "out" / "runs"
MARK = re.compile(r"<!-- run (\w+)( here)? -->")
"""Where a page names an example: a link to its run stands there, or the run itself."""
LINK = ' <a href="{address}" class="run">▶ see the run</a>'
FRAME = (
    '<p><iframe src="{address}" title="A run of {name}" loading="lazy" class="run"></iframe></p>'
    '<p><a href="{address}">▶ the run on a page of its own</a></p>'
)


def main(arguments: list[str]) -> int:
    """Make the pages that are missing, and the site around them."""
    parser = argparse.ArgumentParser(description="Make the site to publish, with runs of all examples.")
    parser.add_argument("--site", type=Path, default=SITE, metavar="FOLDER", help="that Sphinx has built (fame/site)")
    parser.add_argument("--to", type=Path, default=ROOT / "out" / "site", metavar="FOLDER", help="(out/site)")
    options = parser.parse_args(arguments)
    began = time.monotonic()
    pages = kept_pages(KEPT, runs())
    publish(options.site, options.to, pages)
    size = sum(path.stat().st_size for path in options.to.rglob("*") if path.is_file())
    seconds = time.monotonic() - began
    print(f"{options.to}: the site, with {len(pages)} runs: {size / 1e6:.1f} MB, {seconds:.0f} s for the runs")
    return 0


def runs() -> dict[str, Path]:
    """The scenario or model of each example and each pattern, by its name."""
    scenarios = [path for path in (ROOT / "examples").glob("*.yaml") if "\nmodel:" in f"\n{path.read_text('utf-8')}"]
    patterns = {path.parent.name: path for path in (ROOT / "examples" / "cookbook").glob("*/mission.bpmn")}
    with_world = {name: path.with_suffix(".yaml") for name, path in patterns.items()}
    patterns |= {name: path for name, path in with_world.items() if path.exists()}
    return {path.stem: path for path in sorted(scenarios)} | dict(sorted(patterns.items()))


def digest() -> str:
    """What says whether pages are those of this FAME, and of these models and examples."""
    found = sha256()
    files = (path for folder in CODE for path in (ROOT / folder).rglob("*") if path.is_file())
    for path in sorted(path for path in files if not {"site", "__pycache__"} & {*path.parts}):
        found.update(f"{path.relative_to(ROOT)}\n".encode() + path.read_bytes())
    return found.hexdigest()[:16]


def kept_pages(folder: Path, missions: dict[str, Path]) -> dict[str, Path]:
    """The page of each mission, made if it is not there; those that others have left are removed."""
    kept = folder / digest()
    for old in [path for path in folder.glob("*") if path != kept]:
        shutil.rmtree(old)
    kept.mkdir(parents=True, exist_ok=True)
    pages = {name: kept / f"{name}.html" for name in missions}
    for name, page in pages.items():
        if not page.exists():
            write(name, missions[name], page)
    return pages


def write(name: str, mission: Path, page: Path) -> None:
    """Run a mission, and write its page."""
    scenario = Scenario.load(mission)
    command = f"fame run {mission.relative_to(ROOT)} --log {name}.mcap" if mission.is_relative_to(ROOT) else ""
    about = About(metadata={"scenario": name, "seed": str(scenario.seed), "command": command})
    recording = page.with_suffix(".mcap")
    with logging_to(recording, scenario.closures(), about) as log:
        scenario.run(observer=log)
    made = page.with_suffix(".part")
    write_recording(made, recording)
    made.rename(page)
    recording.unlink()


def marked(page: str, text: str) -> str:
    """The Markdown of a page (its path without suffix) with marks for what `publish` puts there."""
    if page in ("docs/cookbook", "examples/README"):
        return re.sub(r"\]\([^()]*?(\w+)(\.yaml|/README\.md)\)", r"\g<0> <!-- run \1 -->", text)
    return f"{text}\n\n<!-- run {Path(page).parent.name} here -->\n" if page.startswith("examples/cookbook/") else text


def publish(site: Path, to: Path, pages: dict[str, Path]) -> None:
    """Copy the site to a folder, with the pages in `runs`, and links to them."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(site, to)
    (to / "runs").mkdir()
    for name, page in pages.items():
        shutil.copy(page, to / "runs" / f"{name}.html")
    for path in to.rglob("*.html"):
        if path.parent != to / "runs":
            text = path.read_text(encoding="utf-8")
            here = {name: os.path.relpath(to / "runs" / f"{name}.html", path.parent) for name in pages}
            linked = MARK.sub(partial(shown, here), text)
            if linked != text:
                path.write_text(linked, encoding="utf-8")


def shown(addresses: dict[str, str], found: re.Match[str]) -> str:
    """What stands for a mark, where the pages of runs have these addresses."""
    name, here = found.groups()
    text = FRAME if here else LINK
    return text.format(address=escape(addresses[name]), name=name.replace("_", " ")) if name in addresses else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
