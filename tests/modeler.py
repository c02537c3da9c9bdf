"""Drives what Camunda Modeler 5 is made of (bpmn-js with its properties panel) in a real browser, in its own words.

Elements are what its registry calls them; titles and labels are those that somebody reads who uses it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from view_page import until

STYLES = (
    "diagram-js", "bpmn-js", "bpmn-font/css/bpmn-embedded", "camunda-platform-modeler", "properties-panel",
    "element-templates",
)  # fmt: skip
PAGE = """<body style="margin: 0">
<div id="canvas" style="position: absolute; inset: 0 360px 0 0"></div>
<div id="panel" style="position: absolute; inset: 0 0 0 auto; width: 360px; overflow: auto"></div>"""
ENTRY = ".bio-properties-panel-collapsible-entry"
LOW = 740
"""Below what is drawn: a click there chooses nothing (pixels from above)."""
NEW = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:bpmndi="http://www.omg.org/spec/BPMN/20100524/DI" xmlns:dc="http://www.omg.org/spec/DD/20100524/DC"
    id="Definitions_1" targetNamespace="http://bpmn.io/schema/bpmn">
  <bpmn:process id="Process_1" isExecutable="true"><bpmn:startEvent id="StartEvent_1" /></bpmn:process>
  <bpmndi:BPMNDiagram id="BPMNDiagram_1"><bpmndi:BPMNPlane id="BPMNPlane_1" bpmnElement="Process_1">
    <bpmndi:BPMNShape id="_BPMNShape_StartEvent_2" bpmnElement="StartEvent_1">
      <dc:Bounds x="179" y="159" width="36" height="36" /></bpmndi:BPMNShape>
  </bpmndi:BPMNPlane></bpmndi:BPMNDiagram>
</bpmn:definitions>"""
"""A new BPMN diagram for Camunda 7, as Camunda Modeler makes it."""


def new_diagram(page: Any, dist: Path, templates: list[Any]) -> Modeler:
    """A page with a new diagram in what Camunda Modeler is made of; `dist`: of the npm package camunda-bpmn-js."""
    page.set_content(PAGE)
    for name in STYLES:
        page.add_style_tag(path=dist / "assets" / f"{name}.css")
    page.add_script_tag(path=dist / "camunda-platform-modeler.production.min.js")
    page.evaluate(
        """async ([text, templates]) => {
            window.modeler = new BpmnModeler({container: '#canvas', propertiesPanel: {parent: '#panel'}})
            await modeler.importXML(text)
            modeler.get('elementTemplatesLoader').setTemplates(templates)
        }""",
        [NEW, templates],
    )
    return Modeler(page, (20, LOW))


class Modeler:
    """A page with a diagram, `modeler`; at `empty` nothing is drawn (pixels).

    `read` is what its user has to know: the titles, labels and values of all that was done. Places are those of the
    diagram. Pictures are `whole`, or as high as is said.
    """

    def __init__(self, page: Any, empty: tuple[float, float], *, whole: bool = False) -> None:
        self.page, self.empty, self.whole = page, empty, whole
        self.read: set[str] = set()
        page.set_default_timeout(5000)

    def begun_with(self) -> str:
        """The one element of a new diagram."""
        (element,) = self._ids()
        return element

    def templates(self, element: str) -> list[str]:
        """The names of the templates that fit an element, which the panel offers under Template."""
        self.select(element)
        self.page.get_by_text("Template", exact=True).wait_for()
        known = "id => modeler.get('elementTemplates').getAll(modeler.get('elementRegistry').get(id)).map(t => t.name)"
        return list(self.page.evaluate(known, element))

    def apply(self, element: str, template: str) -> None:
        """Choose a template for an element; the name is that in the list of the panel."""
        self.page.evaluate(
            """([id, name]) => {
                const found = modeler.get('elementTemplates'), element = modeler.get('elementRegistry').get(id)
                found.applyTemplate(element, found.getAll(element).find(template => template.name === name))
            }""",
            [element, template],
        )

    def shot(self, name: str, element: str, group: str = "", *, high: int = 400) -> None:
        """Keep a picture, `high` pixels, with an element chosen and a group of its panel open, in FAME_SHOTS if there
        is such a folder."""
        if folder := os.environ.get("FAME_SHOTS"):
            if group:
                opened = self._opened(element, group)
                closed = opened.locator(f"{ENTRY}:not(.open) > {ENTRY}-header")
                while closed.count():
                    closed.first.click()
                opened.scroll_into_view_if_needed()
            else:
                self.select(element)
            self.page.mouse.move(*self.empty)
            self.page.wait_for_timeout(300)
            size = self.page.viewport_size
            clip = {"x": 0, "y": 0, **size} | ({} if self.whole else {"height": high})
            self.page.screenshot(path=Path(folder) / f"{name}.png", clip=clip)

    def save(self) -> str:
        """The file."""
        return str(self.page.evaluate("modeler.saveXML({format: true}).then(saved => saved.xml)"))

    def create(self, title: str, x: float, y: float) -> str:
        """Put what the palette has of this title at a place; the id of what was made."""
        self.read.add(title)
        action = self.page.evaluate(
            """title => Object.entries(modeler.get('palette').getEntries())
                .find(([, entry]) => entry.title === title)[0]""",
            title,
        )
        self.page.locator(f".djs-palette [data-action='{action}']").click()
        return self._made(x, y)

    def append(self, element: str, title: str) -> str:
        """Take what the pad beside an element has of this title; the id of what was made."""
        before = self._ids()
        self._pad(element, title)
        return self._new(before)

    def connect(self, source: str, title: str, target: str) -> None:
        """Lead the arrow that the pad beside an element has of this title to another one."""
        self._pad(source, title)
        self.page.mouse.move(*self._place(target, 0.3), steps=4)
        self.page.mouse.click(*self._place(target, 0.3))

    def change(self, element: str, name: str) -> None:
        """Turn an element into another by the spanner; it keeps its id."""
        self.read.add(name)
        self._pad(element, "Change element")
        self.page.locator(".djs-popup .entry").filter(has_text=name).first.click()

    def fill(self, element: str, group: str, **values: str) -> None:
        """Type into the fields of a group of the properties panel, or choose there; the labels are the names."""
        for label, value in values.items():
            self.read |= {group, label.replace("_", " "), value}
            field = self._opened(element, group).locator("label", has_text=label.replace("_", " ")).first
            box = self.page.locator(f"[id='{field.get_attribute('for')}']")
            if box.evaluate("box => box.tagName") == "SELECT":
                box.select_option(label=value)
            else:
                box.fill(value)
                box.blur()

    def extend(self, element: str, **properties: str) -> None:
        """Add extension properties."""
        group = self._opened(element, "Extension properties")
        self.read |= {*properties, *properties.values()}
        for name, value in properties.items():
            group.locator(".bio-properties-panel-add-entry").click()
            for end, text in (("name", name), ("value", value)):
                group.locator(f"input[id$='-{end}']").last.fill(text)
                group.locator(f"input[id$='-{end}']").last.blur()

    def select(self, element: str) -> None:
        """Choose an element, as a click on it does."""
        self.page.mouse.click(*self.empty)
        self.page.mouse.click(*self._place(element))
        until(self.page, f"modeler.get('selection').get()[0]?.id === {element!r}")

    def labels(self, element: str, group: str) -> list[str]:
        """Those of the fields of a group."""
        return list(self._opened(element, group).locator("label").all_inner_texts())

    def _opened(self, element: str, title: str) -> Any:
        self.select(element)
        group = (
            self.page.locator(".bio-properties-panel-group").filter(has=self.page.get_by_text(title, exact=True)).first
        )
        if "open" not in (group.locator(".bio-properties-panel-group-header").get_attribute("class") or "").split():
            group.locator(".bio-properties-panel-group-header-title").click()
        return group

    def _pad(self, element: str, title: str) -> None:
        self.read.add(title)
        self.select(element)
        self.page.locator(f".djs-context-pad [title='{title}']").first.click()

    def _made(self, x: float, y: float) -> str:
        before = self._ids()
        x, y = self.page.evaluate(
            """([x, y]) => {
                const box = modeler.get('canvas').viewbox()
                const {left, top} = modeler.get('canvas').getContainer().getBoundingClientRect()
                return [left + (x - box.x) * box.scale, top + (y - box.y) * box.scale]
            }""",
            [x, y],
        )
        self.page.mouse.move(x, y, steps=4)
        self.page.mouse.click(x, y)
        return self._new(before)

    def _ids(self) -> set[str]:
        return set(
            self.page.evaluate(
                "modeler.get('elementRegistry').filter(e => !e.waypoints && !e.labelTarget && e.parent).map(e => e.id)"
            )
        )

    def _new(self, before: set[str]) -> str:
        (made,) = self._ids() - before
        self.page.mouse.click(*self.empty)  # ends the editing of its label
        return str(made)

    def _place(self, element: str, part: float = 0.5) -> tuple[float, float]:
        """Of a point of an element on the page; `part` of its width and height from its upper left corner."""
        x, y, width, height = self.page.evaluate(
            """id => {
                const box = modeler.get('canvas').getGraphics(id).querySelector('.djs-hit').getBoundingClientRect()
                return [box.x, box.y, box.width, box.height]
            }""",
            element,
        )
        return x + part * width, y + part * height
