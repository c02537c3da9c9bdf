"""Draws shapes: pools, activities, events, gateways, data, artifacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fame.bpmn.draw import style
from fame.bpmn.draw.style import BACKGROUND, BAND_FILL, SIZE, SMALL, Ink, Picture, text_colour
from fame.bpmn.draw.svg import corners, fit_in_box, number, tag, text_lines, translated, wrap
from fame.bpmn.model import (
    GATEWAYS,
    PLACES,
    Activity,
    Bounds,
    CallActivity,
    DataObject,
    Element,
    Event,
    Gateway,
    MultiInstance,
    Participant,
    Shape,
    SubProcess,
    Task,
)


def draw_shape(picture: Picture, shape: Shape) -> str:
    """Return a shape with its name, in a group with the id of the element."""
    draws = _SHAPES.get(shape.kind, _activity)
    return tag("g", draws(picture, shape, picture.elements[shape.element]), id=shape.element)


def placeholder(shape: Shape) -> Element:
    """Return an element with kind and name of a shape, for elements that the model does not have."""
    if shape.kind in PLACES:
        return Event(id=shape.element, name=shape.name, place=PLACES[shape.kind])
    if shape.kind in GATEWAYS:
        return Gateway(id=shape.element, name=shape.name, kind=GATEWAYS[shape.kind])
    return Element(id=shape.element, name=shape.name)


def _box(bounds: Bounds, ink: Ink, width: float = 2, radius: float = 0, dashes: str = "") -> str:
    return tag(
        "rect",
        x=bounds.x,
        y=bounds.y,
        width=bounds.width,
        height=bounds.height,
        rx=radius or None,
        fill=ink[1],
        stroke=ink[0],
        stroke_width=width,
        stroke_dasharray=dashes,
    )


def _shrunk(bounds: Bounds, by: float) -> Bounds:
    return Bounds(bounds.x + by, bounds.y + by, bounds.width - 2 * by, bounds.height - 2 * by)


def _pool(picture: Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    if shape.kind == "lane" and ink[1] == BACKGROUND:
        ink = ink[0], "none"
    marks = ""
    if isinstance(element, Participant) and element.multi_instance:
        x, y = bounds.x + bounds.width / 2 - 7, bounds.y + bounds.height - 18
        marks = translated(x, y, style.marker("parallel", ink))
    if shape.kind == "participant" and not getattr(element, "process", ""):
        paper = BAND_FILL if shape.band.endswith("non_initiating") else ink[1]
        return _box(bounds, (ink[0], paper), 1.5) + _centred(element.name, bounds, ink) + marks
    band = 30.0
    if shape.horizontal:
        line = f"M{number(bounds.x + band)} {number(bounds.y)}v{number(bounds.height)}"
    else:
        line = f"M{number(bounds.x)} {number(bounds.y + band)}h{number(bounds.width)}"
    rule = tag("path", d=line, stroke=ink[0], stroke_width=1.5) if shape.kind == "participant" else ""
    return _box(bounds, ink, 1.5) + rule + _banner(element.name, shape, band, ink) + marks


def _banner(name: str, shape: Shape, band: float, ink: Ink) -> str:
    """The name of a pool or lane in its band: horizontal for a vertical pool, rotated for a horizontal one."""
    bounds, turn = shape.bounds, " rotate(-90)" if shape.horizontal else ""
    length = bounds.height if shape.horizontal else bounds.width
    middle = (band / 2, length / 2) if shape.horizontal else (length / 2, band / 2)
    x, y = number(bounds.x + middle[0]), number(bounds.y + middle[1])
    return tag(
        "g", _centred(name, Bounds(-length / 2, -band / 2, length, band), ink), transform=f"translate({x} {y}){turn}"
    )


def _centred(name: str, bounds: Bounds, ink: Ink, corner: float = 0) -> str:
    """A name in the middle of a box, clear of a pictogram of size `corner` at the upper left."""
    setting = fit_in_box(name, bounds, SIZE, corner)
    return text_lines(setting.lines, bounds.x + bounds.width / 2, setting.top, size=setting.size, fill=text_colour(ink))


def _activity(picture: Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    open_body = shape.expanded and (isinstance(element, SubProcess) or shape.kind == "subChoreography")
    by_event = isinstance(element, SubProcess) and element.triggered_by_event
    box = _box(bounds, ink, 5 if isinstance(element, CallActivity) else 2, 10, "1 5" if by_event else "")
    if isinstance(element, SubProcess) and element.kind == "transaction":
        box += _box(_shrunk(bounds, 3), ink, 1.5, 8)
    markers = _markers(shape, element, ink)
    icon = style.task(element.kind, ink) if isinstance(element, Task) else ""
    if open_body:
        lines = wrap(element.name, bounds.width - 20, SIZE)
        name = text_lines(lines, bounds.x + bounds.width / 2, bounds.y + 6, size=SIZE, fill=text_colour(ink))
    else:
        room = Bounds(bounds.x, bounds.y, bounds.width, bounds.height - (16 if markers else 0))
        name = _centred(element.name, room, ink, 25 if icon else 0)
    return box + (translated(bounds.x + 6, bounds.y + 6, icon) if icon else "") + name + markers


def _markers(shape: Shape, element: Element, ink: Ink) -> str:
    kinds: list[str] = []
    if isinstance(element, Activity):
        if element.for_compensation:
            kinds.append("compensation")
        if isinstance(element.loop, MultiInstance):
            kinds.append("sequential" if element.loop.sequential else "parallel")
        elif element.loop is not None:
            kinds.append("loop")
    if isinstance(element, SubProcess) and element.kind == "adhoc":
        kinds.append("adhoc")
    if isinstance(element, CallActivity) or (isinstance(element, SubProcess) and not shape.expanded):
        kinds.append("collapsed")
    bounds = shape.bounds
    left = bounds.x + bounds.width / 2 - 9 * len(kinds) + 2
    y = bounds.y + bounds.height - 19
    return "".join(translated(left + 18 * place, y, style.marker(kind, ink)) for place, kind in enumerate(kinds))


def _event(picture: Picture, shape: Shape, element: Element) -> str:
    if not isinstance(element, Event):
        return ""
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, radius = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2, bounds.width / 2
    throws = element.place in ("throw", "end")
    dashes = "6 4" if not element.interrupting and element.place in ("start", "boundary") else ""
    widths = {"end": [(radius - 1, 4.0)], "start": [(radius, 2.0)]}
    rings = widths.get(element.place, [(radius, 1.5), (radius - 3.5, 1.5)])
    circles = [
        tag("circle", cx=x, cy=y, r=r, fill=ink[1], stroke=ink[0], stroke_width=width, stroke_dasharray=dashes)
        for r, width in rings
    ]
    icon = style.trigger(_trigger(element), ink, throws)
    scale = bounds.width / 36
    inside = translated(x - 18 * scale, y - 18 * scale, icon, scale=scale) if icon else ""
    return "".join(circles) + inside + picture.label(shape.element, text_colour(ink))


def _trigger(event: Event) -> str:
    if len(event.definitions) > 1:
        return "parallel_multiple" if event.parallel else "multiple"
    return event.definitions[0].trigger if event.definitions else ""


def _gateway(picture: Picture, shape: Shape, element: Element) -> str:
    if not isinstance(element, Gateway):
        return ""
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, w, h = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2, bounds.width / 2, bounds.height / 2
    points = corners([(x, y - h), (x + w, y), (x, y + h), (x - w, y)])
    diamond = tag("polygon", points=points, fill=ink[1], stroke=ink[0], stroke_width=2, stroke_linejoin="round")
    sign = style.gateway(element.kind, ink, shape.marker_visible)
    inside = translated(x, y, sign, scale=bounds.width / 50) if sign else ""
    return diamond + inside + picture.label(shape.element, text_colour(ink))


def _data(picture: Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, w, h = bounds.x, bounds.y, bounds.width, bounds.height
    if shape.kind in ("dataStoreReference", "dataStore"):
        return _store(bounds, ink) + picture.label(shape.element, text_colour(ink))
    fold = min(10, w / 3)
    page = [(x, y), (x + w - fold, y), (x + w, y + fold), (x + w, y + h), (x, y + h)]
    corner = [(x + w - fold, y), (x + w - fold, y + fold), (x + w, y + fold)]
    stroke = {"stroke": ink[0], "stroke_width": 2, "stroke_linejoin": "round"}
    drawn = tag("polygon", points=corners(page), fill=ink[1], **stroke)
    drawn += tag("polyline", points=corners(corner), fill="none", **stroke)
    if isinstance(element, DataObject) and element.collection:
        drawn += translated(x + w / 2 - 7, y + h - 18, style.marker("parallel", ink))
    if shape.kind in ("dataInput", "dataOutput"):
        filled = shape.kind == "dataOutput"
        drawn += translated(x + 1, y + 1, style.trigger("link", ink, filled), scale=0.5)
    return drawn + picture.label(shape.element, text_colour(ink))


def _name_with_state(element: Element) -> str:
    state = element.state if isinstance(element, DataObject) else ""
    return f"{element.name}\n[{state}]" if state else element.name


def _store(bounds: Bounds, ink: Ink) -> str:
    x, y, w, h = bounds.x, bounds.y, bounds.width, bounds.height
    lid = min(h / 6, 10)
    arc = f"{number(w / 2)} {number(lid)} 0 0"
    barrel = f"M{number(x)} {number(y + lid)}A{arc} 1 {number(x + w)} {number(y + lid)}V{number(y + h - lid)}"
    barrel += f"A{arc} 1 {number(x)} {number(y + h - lid)}Z"
    rims = "".join(
        f"M{number(x)} {number(y + lid * level)}A{arc} 0 {number(x + w)} {number(y + lid * level)}"
        for level in (1, 1.7, 2.4)
    )
    drawn = tag("path", d=barrel, fill=ink[1], stroke=ink[0], stroke_width=2)
    return drawn + tag("path", d=rims, fill="none", stroke=ink[0], stroke_width=2)


def _conversation(picture: Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, w, h = bounds.x, bounds.y, bounds.width, bounds.height
    points = corners([(x, y + h / 2), (x + w / 4, y), (x + 3 * w / 4, y), (x + w, y + h / 2), (x + 3 * w / 4, y + h),
                      (x + w / 4, y + h)])  # fmt: skip
    width = 5 if shape.kind == "callConversation" else 2
    hexagon = tag("polygon", points=points, fill=ink[1], stroke=ink[0], stroke_width=width, stroke_linejoin="round")
    plus = (
        translated(x + w / 2 - 7, y + h - 19, style.marker("collapsed", ink)) if shape.kind == "subConversation" else ""
    )
    return hexagon + plus + picture.label(shape.element, text_colour(ink))


def _message(picture: Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, w, h = bounds.x, bounds.y, bounds.width, bounds.height
    flap = tag("polyline", points=corners([(x, y), (x + w / 2, y + h / 2), (x + w, y)]), fill="none", stroke=ink[0])
    return _box(bounds, ink, 1.5) + flap + picture.label(shape.element, text_colour(ink))


def _annotation(picture: Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    bracket = f"M{number(bounds.x + 10)} {number(bounds.y)}h-10v{number(bounds.height)}h10"
    lines = wrap(element.name, max(bounds.width - 10, 30), SIZE)
    content = text_lines(lines, bounds.x + 6, bounds.y + 4, size=SIZE, fill=text_colour(ink), anchor="start")
    return tag("path", d=bracket, fill="none", stroke=ink[0], stroke_width=2) + content


def _group(picture: Picture, shape: Shape, element: Element) -> str:
    stroke, _ = picture.ink(shape)
    box = _box(shape.bounds, (stroke, "none"), 1.5, 10, "10 6 0 6")
    if shape.label is None:
        bounds = shape.bounds
        lines = wrap(element.name, bounds.width, SMALL)
        return box + text_lines(lines, bounds.x + bounds.width / 2, bounds.y + 4, size=SMALL, fill=stroke)
    return box + picture.label(shape.element, stroke)


def name_beside(shape: Shape, element: Element) -> str:
    """Return the name of an element that is drawn beside its shape; empty if it is drawn inside."""
    draws = _SHAPES.get(shape.kind, _activity)
    if draws is _data:
        return _name_with_state(element)
    beside = draws in (_event, _gateway, _conversation, _message) or (draws is _group and shape.label is not None)
    return element.name if beside else ""


_SHAPES: Mapping[str, Callable[[Picture, Shape, Element], str]] = {
    "participant": _pool,
    "lane": _pool,
    **dict.fromkeys(PLACES, _event),
    **dict.fromkeys(GATEWAYS, _gateway),
    "dataObjectReference": _data,
    "dataObject": _data,
    "dataStoreReference": _data,
    "dataInput": _data,
    "dataOutput": _data,
    "dataStore": _data,
    "conversation": _conversation,
    "subConversation": _conversation,
    "callConversation": _conversation,
    "message": _message,
    "textAnnotation": _annotation,
    "group": _group,
}
"""Tag -> drawing function; the default is `_activity`."""
