"""Texts of the page can be read: contrast of at least 4.5 to 1 (WCAG 2.2, level AA) in light and dark."""

import re
from pathlib import Path

import pytest

from sim2d.style import ROBOTS

PAGE = Path(__file__).parent.parent / "fame" / "view" / "page"
ON_PANELS = ("ink", "muted", "accent", "completed", "failed", "cancelled", "active", "warning", "note", "arrow")
PAIRS = (
    *((text, "panel") for text in ON_PANELS),
    *((text, "page") for text in ("ink", "muted", "accent", "completed", "failed", "warning")),
    ("ink", "soft"), ("muted", "soft"), ("ink", "active-paper"), ("ink", "completed-paper"), ("ink", "failed-paper"),
    ("ink", "cancelled-paper"), ("ink", "accent-soft"), ("accent", "accent-soft"), ("warning", "active-paper"),
    ("on", "completed"), ("on", "failed"), ("on", "cancelled"), ("on", "accent"), ("panel", "ink"),
)  # fmt: skip


def variables(theme: str) -> dict[str, str]:
    """The colours of a theme, by name."""
    css = (PAGE / "style.css").read_text(encoding="utf-8")
    head = ':root[data-theme="dark"] {' if theme == "dark" else ":root {"
    block = css[css.index(head) :].partition("}")[0]
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block))


def luminance(colour: str) -> float:
    """Relative luminance of a colour #rrggbb (WCAG 2.2)."""
    parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    """The contrast of two colours, from 1 to 21 (WCAG 2.2)."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("pair", PAIRS, ids="-on-".join)
def test_texts_are_in_contrast_to_what_they_are_on(theme: str, pair: tuple[str, str]) -> None:
    colours = variables(theme)
    assert contrast(colours[pair[0]], colours[pair[1]]) >= 4.5


def test_pictures_and_films_have_the_colours_of_the_page() -> None:
    script = (PAGE / "dom.js").read_text(encoding="utf-8")
    listed = re.search(r"const LIGHT = \[(.*?)\]", script)
    assert listed is not None
    assert tuple(re.findall(r"#[0-9a-f]{6}", listed[1])) == ROBOTS


@pytest.mark.parametrize(("name", "ground"), [("LIGHT", "#f6f4ee"), ("DARK", "#20242a")])
def test_the_names_of_robots_can_be_read_on_the_ground(name: str, ground: str) -> None:
    script = (PAGE / "dom.js").read_text(encoding="utf-8")
    listed = re.search(rf"const {name} = \[(.*?)\]", script)
    assert listed is not None
    for colour in re.findall(r"#[0-9a-f]{6}", listed[1]):
        assert contrast(colour, ground) >= 4.5, colour
