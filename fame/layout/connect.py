"""Routes the links of a diagram and places their labels: first those of each scope, then those that leave one."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

from fame.bpmn.draw.style import SIZE
from fame.bpmn.draw.svg import Obstacles, Point, crosses, text_width
from fame.bpmn.model import Bounds
from fame.layout.arrange import HEADER
from fame.layout.content import (
    ARTIFACTS,
    BODIES,
    DiagramContent,
    LayoutBox,
    LayoutLink,
    label_size,
)
from fame.layout.routing import (
    Docking,
    Ends,
    Obstacle,
    RoutingGrid,
    dockings,
    straightened,
)

_NEVER = float("inf")
_INSET, _OUTSIDE = 6.0, 80.0
_LABEL_MARGIN = 3.0


def connect(content: DiagramContent) -> None:
    """Set the way points of every link that has none, and the labels of flows."""
    for plane in content.planes:
        boxes = [box for frame in plane.frames for box in (frame, *frame.inner())] + plane.loose
        members = set(boxes)
        links = [link for link in content.links if box_of(link.source) in members]
        for link in links:
            if _belongs(link):
                link.waypoints = link.waypoints or _upright(link)
        for frame in boxes:
            if frame.expanded:
                own = [link for link in links if box_of(link.source).parent is frame is box_of(link.target).parent]
                own = [link for link in own if _between_boxes(link)]
                _route(own, frame.children, room_of(frame), links, [frame])
        if boxes:
            frames = [box for box in boxes if box.expanded]
            for to_flows in (False, True):  # an end can be a flow, which has its way by then
                waiting = [link for link in links if to_flows or _between_boxes(link)]
                _route(waiting, boxes, _whole(boxes), links, frames)
        _place_labels(links, boxes)


def box_of(end: LayoutBox | LayoutLink) -> LayoutBox:
    """Return the box of an end; of a flow that from which it comes."""
    while isinstance(end, LayoutLink):
        end = end.source
    return end


def _between_boxes(link: LayoutLink) -> bool:
    return isinstance(link.source, LayoutBox) and isinstance(link.target, LayoutBox)


def _belongs(link: LayoutLink) -> bool:
    """Whether a link leads from an artifact to the node that it stands above."""
    ends = (link.source, link.target)
    return any(
        isinstance(a, LayoutBox)
        and isinstance(b, LayoutBox)
        and a.host is b
        and a.kind in ARTIFACTS
        and _is_above(a, b)
        for a, b in (ends, ends[::-1])
    )


def _is_above(artifact: LayoutBox, node: LayoutBox) -> bool:
    apart = node.y - node.height / 2 - artifact.y - artifact.height / 2
    return 0 < apart < 100 and abs(artifact.x - node.x) < node.width / 2 + 60 * len(node.artifacts)


def _upright(link: LayoutLink) -> list[Point]:
    """A straight line between an artifact and the node below it, as far as possible upright."""
    source, target = link.source, link.target
    assert isinstance(source, LayoutBox)
    assert isinstance(target, LayoutBox)
    artifact, node = (source, target) if source.host is target else (target, source)
    reach = max(node.width / 2 - 10, 0) if not node.kind.endswith(("Event", "Gateway")) else 0.0
    x = min(max(artifact.x, node.x - reach), node.x + reach)
    half = max(artifact.width / 2 - 5, 0)
    start = min(max(x, artifact.x - half), artifact.x + half), artifact.y + artifact.height / 2
    points = [start, (x, node.y - node.height / 2)]
    return points if artifact is source else points[::-1]


def room_of(frame: LayoutBox) -> Bounds:
    """Return the inside of a frame, right of the names of a pool and its lanes."""
    left = frame.width - min((lane.width for lane in _leaves(frame.lanes)), default=frame.width)
    left += HEADER if frame.kind == "participant" else 0.0
    box = frame.bounds
    return Bounds(box.x + left + _INSET, box.y + _INSET, box.width - left - 2 * _INSET, box.height - 2 * _INSET)


def _leaves(lanes: Iterable[LayoutBox]) -> Iterator[LayoutBox]:
    for lane in lanes:
        yield lane
        yield from _leaves(lane.lanes)


def _whole(boxes: Sequence[LayoutBox]) -> Bounds:
    filled = [box.bounds for box in boxes]
    left, top = min(box.x for box in filled) - _OUTSIDE, min(box.y for box in filled) - _OUTSIDE
    right, bottom = max(box.x + box.width for box in filled), max(box.y + box.height for box in filled)
    return Bounds(left, top, right + _OUTSIDE - left, bottom + _OUTSIDE - top)


# ---- routes ----------------------------------------------------------------------------------------------------------


def _route(
    links: Iterable[LayoutLink],
    boxes: Sequence[LayoutBox],
    room: Bounds,
    routed: Iterable[LayoutLink],
    frames: Iterable[LayoutBox],
) -> None:
    """Route links around boxes and the names of frames, the shortest first, so that what can be straight is."""
    waiting = [link for link in links if not link.waypoints]
    if not waiting:
        return
    obstacles = [one for box in boxes for one in _obstacles(box)]
    obstacles += [Obstacle(("title", box.id), _title(box), _LABEL_MARGIN) for box in frames if box.kind in BODIES]
    gates = {link: (list(_dockings(link, link.source)), list(_dockings(link, link.target))) for link in waiting}
    grid = RoutingGrid(obstacles, room, [port.point for pair in gates.values() for side in pair for port in side])
    for link in routed:
        if link.waypoints:
            grid.add(link.waypoints, _ends(link))
    for link in sorted(waiting, key=_urgency):
        sources, targets = gates[link]
        if not sources or not targets:  # a flow that is not drawn
            continue
        around = {box for end in (link.source, link.target) for box in box_of(end).around()}
        inside = set() if box_of(link.source).parent is box_of(link.target).parent else around
        points = grid.route(sources, targets, _ends(link), inside)
        link.waypoints = points or straightened([sources[0].point, targets[0].point])
        grid.add(link.waypoints, _ends(link))


def _ends(link: LayoutLink) -> Ends:
    return Ends(link.source, link.target)


def _urgency(link: LayoutLink) -> tuple[bool, bool, float]:
    """Sequence flows come first, those that point back last of them, short ones before long ones."""
    a, b = box_of(link.source), box_of(link.target)
    return link.kind != "sequenceFlow", b.x < a.x, abs(a.x - b.x) + 3 * abs(a.y - b.y)


def _title(frame: LayoutBox) -> Bounds:
    """Where the name of an open sub-process is."""
    width = min(text_width(frame.name, SIZE), frame.width - 20)
    return Bounds(frame.x - width / 2, frame.y - frame.height / 2 + 6, width, 14)


def _obstacles(box: LayoutBox) -> Iterator[Obstacle]:
    if box.kind != "participant" or not box.expanded:
        yield Obstacle(box, box.bounds)
    if (label := box.label_bounds) is not None:
        yield Obstacle(("label", box.id), label, _LABEL_MARGIN)


def _dockings(link: LayoutLink, end: LayoutBox | LayoutLink) -> Iterator[Docking]:
    """Where a link can leave or reach one of its ends."""
    if isinstance(end, LayoutLink):
        for (x, y), (to_x, to_y) in pairwise(end.waypoints):
            middle = round((x + to_x) / 2, 2), round((y + to_y) / 2, 2)
            yield from (Docking(middle, direction) for direction in ((1, 3) if y == to_y else (0, 2)))
    elif end.kind == "participant":
        other = box_of(link.target if end is link.source else link.source)
        box = end.bounds
        x = min(max(other.x, box.x + 50), box.x + box.width - 20) if other.kind != "participant" else end.x
        yield from dockings(Bounds(x, box.y, 0.0, box.height), (_NEVER, 0, _NEVER, 0))
    else:
        yield from dockings(end.bounds, _costs(link, end))


def _costs(link: LayoutLink, end: LayoutBox) -> tuple[float, float, float, float]:
    """What it costs to use the right, lower, left and upper side of a node."""
    if end.kind == "boundaryEvent" and end.host is not None:
        return (100, 0, 100, 300) if end is link.source else (60, 0, 60, 300)
    if link.kind == "messageFlow":
        return 200, 0, 200, 0
    if link.kind != "sequenceFlow":
        return 40, 0, 40, 0
    aside = 0.0 if end.kind.endswith("Gateway") else 70.0
    return (0, aside, 300, aside) if end is link.source else (300, aside, 0, aside)


# ---- labels of flows -------------------------------------------------------------------------------------------------


def _place_labels(links: Sequence[LayoutLink], boxes: Sequence[LayoutBox]) -> None:
    """Put the names of flows beside them, near their beginning, where they cover nothing."""
    filled = [box.bounds for box in boxes if not box.expanded and box.kind != "lane"]
    filled += [label for box in boxes if (label := box.label_bounds) is not None]
    borders = [line for box in boxes if box.expanded for line in _borders(box.bounds)]
    lines = [line for link in links for line in pairwise(link.waypoints)]
    taken = Obstacles(filled + [link.label for link in links if link.label is not None], lines + borders)
    siblings: defaultdict[LayoutBox | LayoutLink, list[LayoutLink]] = defaultdict(list)
    for link in links:
        siblings[link.source].append(link)
    for link in links:
        width, height = label_size(link.name)
        if not width or link.label is not None or link.kind not in ("sequenceFlow", "messageFlow"):
            continue
        beside = _beside(link.waypoints, [one for one in siblings[link.source] if one is not link], width, height)
        spots = [Bounds(x, y, width, height) for x, y in beside]
        link.label = next((spot for spot in spots if not taken.count(spot)), None) or min(spots, key=taken.count)
        taken.boxes.append(link.label)


def _borders(box: Bounds) -> Iterator[tuple[Point, Point]]:
    right, bottom = box.x + box.width, box.y + box.height
    corners = [(box.x, box.y), (right, box.y), (right, bottom), (box.x, bottom), (box.x, box.y)]
    yield from pairwise(corners)


def _beside(points: Sequence[Point], others: Sequence[LayoutLink], width: float, height: float) -> Iterator[Point]:
    """Places for a label above, below and beside the stretches of a line: those on which no other link from the same
    source runs come first, then those that are long enough."""
    shared = [line for other in others for line in pairwise(other.waypoints)]

    def rank(stretch: tuple[Point, Point]) -> tuple[bool, bool]:
        (x, y), (to_x, to_y) = stretch
        line = Bounds(min(x, to_x) - 1, min(y, to_y) - 1, abs(to_x - x) + 2, abs(to_y - y) + 2)
        common = sum(crosses(line, *other) for other in shared if (other[0][0] == other[1][0]) == (x == to_x))
        return common > 0, abs(to_x - x) < width + 8 and abs(to_y - y) < height + 8

    for (x, y), (to_x, to_y) in sorted(pairwise(points), key=rank):
        for part in (0.0, 0.25, 0.5, 0.75, 1.0):
            if y == to_y:
                low, high = min(x, to_x) + 6, max(x, to_x) - 12 - width
                at = (low + high) / 2 if high < low else low + (high - low) * (part if x < to_x else 1 - part)
                yield at, y - height - 3
                yield at, y + 3
            else:
                low, high = min(y, to_y) + 6, max(y, to_y) - 6 - height
                at = (low + high) / 2 if high < low else low + (high - low) * (part if y < to_y else 1 - part)
                yield x + 5, at
                yield x - width - 5, at
