"""How flows and associations are drawn."""

from __future__ import annotations

from collections.abc import Mapping

from fame.bpmn.draw.icons import Ink
from fame.bpmn.draw.outcome import badge
from fame.bpmn.draw.picture import PAPER, Picture, visited
from fame.bpmn.draw.svg import arrow, corners, middle, polyline, tag, towards
from fame.bpmn.model import Activity, Edge, Gateway, SequenceFlow


def draw_edge(picture: Picture, edge: Edge) -> str:
    """A flow or association without its name, in a group that has the id of the element."""
    ink = picture.ink(edge)
    style = {"fill": "none", "stroke": ink[0], "stroke_linecap": "round", "stroke_linejoin": "round"}
    if edge.kind == "sequenceFlow":
        content = _sequence_flow(picture, edge, ink, style)
    elif edge.kind == "messageFlow":
        content = _message_flow(edge, ink, style)
    elif edge.kind == "conversationLink":
        content = "".join(
            tag("path", d=polyline(edge.waypoints), **{**style, "stroke": colour}, stroke_width=width)
            for colour, width in ((ink[0], 5), (PAPER, 2))
        )
    else:
        line = tag("path", d=polyline(edge.waypoints), stroke_width=2, stroke_dasharray="0 5", **style)
        head = tag("polyline", points=corners(arrow(edge.waypoints, 8, 9)), stroke_width=1.5, **style)
        content = line + (head if edge.directed else "")
    return tag("g", content, id=edge.element)


def _sequence_flow(picture: Picture, edge: Edge, ink: Ink, style: Mapping[str, str]) -> str:
    points = list(edge.waypoints)
    width = 2.5 if visited(ink) else 1.5
    head = tag("polygon", points=corners(arrow(points)), fill=ink[0], stroke=ink[0], stroke_linejoin="round")
    line = polyline([*points[:-1], towards(points[-1], points[-2], 4)])
    drawn = tag("path", d=line, stroke_width=width, **style) + head
    flow = picture.elements.get(edge.element)
    source = picture.elements.get(flow.source) if isinstance(flow, SequenceFlow) else None
    if isinstance(flow, SequenceFlow) and isinstance(source, Activity | Gateway) and source.default == flow.id:
        x, y = towards(points[0], points[1], 10)
        side = arrow([points[0], (x, y)], 6, 10)
        drawn += tag(
            "polyline", points=corners([side[0], (2 * x - side[0][0], 2 * y - side[0][1])]), stroke_width=1.5, **style
        )
    elif isinstance(flow, SequenceFlow) and flow.condition is not None and isinstance(source, Activity):
        half, end = towards(points[0], points[1], 8), towards(points[0], points[1], 16)
        sides = arrow([points[0], half], 0.01, 8)
        diamond = [points[0], sides[0], end, sides[2]]
        drawn += tag("polygon", points=corners(diamond), **{**style, "fill": PAPER})
    return drawn


def _message_flow(edge: Edge, ink: Ink, style: Mapping[str, str]) -> str:
    line = tag("path", d=polyline(edge.waypoints), stroke_width=1.5, stroke_dasharray="10 8", **style)
    start = tag("circle", cx=edge.waypoints[0][0], cy=edge.waypoints[0][1], r=3.5, fill=PAPER, stroke=ink[0])
    return line + start + tag("polygon", points=corners(arrow(edge.waypoints)), **{**style, "fill": PAPER})


def draw_edge_label(picture: Picture, edge: Edge) -> str:
    """Its name, and how often it was gone, if more than once."""
    visits = picture.visits.get(edge.element, {}).get("completed", 0)
    return (badge(str(visits), *middle(edge.waypoints)) if visits > 1 else "") + picture.label(edge.element)
