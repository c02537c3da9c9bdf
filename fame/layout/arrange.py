"""Arranges boxes from the inside out: the nodes of each sub-process, then of each pool, then the pools of a diagram.

Connected parts of a scope are laid out in layers, one below the other; event sub-processes and what is connected to
nothing stand in rows below them. Boundary events stand on the lower border of their host, data objects and annotations
above the node that they are about. All lengths are in px.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import permutations

from fame.bpmn.model import Bounds
from fame.dataclasses import dataclass
from fame.layout.content import (
    ARTIFACTS,
    LABEL_GAP,
    DiagramContent,
    LayoutBox,
    LayoutLink,
    Plane,
    label_size,
)
from fame.layout.layers import Arc, Layers, layered, set_rows

HEADER = 30.0
"""The band of a pool or lane with its name."""
_GAP, _TRACK, _LABEL_IN_GAP = 50.0, 12.0, 20.0
_SIDE, _TOP = 40.0, 40.0
"""Between the content of a sub-process or pool and its border."""
_ROW_GAP, _ROW_WIDTH = 40.0, 900.0
_POOL_GAP, _BLACK_BOX, _LANE = 50.0, 60.0, 120.0
_START = (160.0, 80.0)
"""Where a diagram begins, as in Camunda Modeler."""
_MOST_ORDERED = 6
_SMALL = 120.0
"""Wider nodes do not move the middle of their column."""


@dataclass(slots=True)
class Area:
    """A part of a scope that is laid out on its own: its boxes and the rectangle that they fill from (0, 0)."""

    boxes: list[LayoutBox]
    width: float = 0.0
    height: float = 0.0


def arrange(content: DiagramContent) -> None:
    """Set the place of every box, and of the labels of nodes."""
    inside = by_scope(content.links)
    for plane in content.planes:
        pairs = _order_pools(plane, content.links)
        for frame in plane.frames:
            arrange_frame(frame, inside)
        stack(plane, pairs)


def by_scope(links: Iterable[LayoutLink]) -> Mapping[LayoutBox, list[LayoutLink]]:
    """Return the links that order the nodes of each scope: sequence flows, and those to handlers of compensation."""
    found: defaultdict[LayoutBox, list[LayoutLink]] = defaultdict(list)
    for link in links:
        source, target = link.source, link.target
        if not isinstance(source, LayoutBox) or not isinstance(target, LayoutBox) or source.parent is None:
            continue
        compensates = link.kind == "association" and source.host is not None and source.kind == "boundaryEvent"
        ordering = link.kind == "sequenceFlow" or (compensates and target.kind not in ARTIFACTS)
        if ordering and source.parent is target.parent:
            found[source.parent].append(link)
    return found


# ---- what belongs to a node ------------------------------------------------------------------------------------------


def _place_guests(host: LayoutBox, leaving: set[LayoutBox]) -> None:
    """Put boundary events on the lower border of their host, from its right end, each with its label below it on the
    left of its way out. An activity is widened until they fit."""
    slots = [max(event.label_size[0] + 26, 46) for event in host.guests]
    host.width = max(host.width, sum(slots) + 10)
    right = host.x + host.width / 2 - 10
    for event, slot in zip(reversed(host.guests), reversed(slots), strict=True):
        event.x, event.y = right - 18, host.y + host.height / 2
        place_guest_label(event, leaves=event in leaving)
        right -= slot


def place_guest_label(event: LayoutBox, *, leaves: bool = True) -> None:
    """Put the label of a boundary event below it, beside a flow that leaves there."""
    width, height = event.label_size
    if width:
        event.label = Bounds(-LABEL_GAP - width if leaves else -width / 2, 20, width, height)


def _place_label(box: LayoutBox, *, rises: bool = False, falls: bool = False) -> None:
    """Put a label above a gateway or data object, below an event, unless links leave there; then at the other side, or
    on the left of both."""
    width, height = box.label_size
    if not width or (box.host is not None and box.kind == "boundaryEvent"):
        return
    rises, falls = rises or box.rises, falls or box.falls
    over = falls and not rises if box.kind.endswith("Event") else not rises or falls
    left = -width - 6 if rises and falls else -width / 2
    box.label = Bounds(
        left, -box.height / 2 - LABEL_GAP - height if over else box.height / 2 + LABEL_GAP, width, height
    )


def _place_artifacts(box: LayoutBox) -> None:
    """Put data objects and annotations in a row above a node."""
    if not box.artifacts:
        return
    for artifact in box.artifacts:
        _place_label(artifact)
        artifact.reach = _reach(artifact, [artifact])
    top = -box.height / 2
    top = min(top, box.label.y) if box.label is not None and box.label.y < 0 else top
    across = sum(one.reach[0] + one.reach[2] for one in box.artifacts) + 20 * (len(box.artifacts) - 1)
    left = box.x - across / 2
    for artifact in box.artifacts:
        artifact.move(left + artifact.reach[0] - artifact.x, box.y + top - 30 - artifact.height / 2 - artifact.y)
        left += artifact.reach[0] + artifact.reach[2] + 20


def _reach(box: LayoutBox, parts: Iterable[LayoutBox]) -> tuple[float, float, float, float]:
    """How far boxes and their labels extend around the middle of one."""
    filled = [bounds for part in parts for bounds in (part.bounds, part.label_bounds) if bounds is not None]
    return (
        box.x - min(bounds.x for bounds in filled),
        box.y - min(bounds.y for bounds in filled),
        max(bounds.x + bounds.width for bounds in filled) - box.x,
        max(bounds.y + bounds.height for bounds in filled) - box.y,
    )


def complete_node(box: LayoutBox, *, artifacts: bool = True) -> None:
    """Place what belongs to a node whose label has its place, and measure the whole."""
    if box.label is None:
        _place_label(box)
    if artifacts:
        _place_artifacts(box)
    box.reach = _reach(box, (box, *box.guests, *(box.artifacts if artifacts else ())))


def put(box: LayoutBox, x: float, y: float) -> None:
    """Move a node, with all that belongs to it, to a place."""
    by = x - box.x, y - box.y
    for part in (box, *box.guests, *box.artifacts):
        part.move(*by)


# ---- scopes ----------------------------------------------------------------------------------------------------------


def arrange_frame(frame: LayoutBox, inside: Mapping[LayoutBox, list[LayoutLink]]) -> None:
    """Arrange what is in a pool, process or sub-process, and set its size. Its left upper corner is at (0, 0)."""
    links = inside.get(frame, [])
    leaving = {link.source for link in links if isinstance(link.source, LayoutBox)}
    attached = {box for host in frame.children for box in (*host.guests, *host.artifacts)}
    nodes = [box for box in frame.children if box not in attached]
    for box in nodes:
        if box.expanded:
            arrange_frame(box, inside)
        _place_guests(box, leaving) if box.guests else None
        complete_node(box)
    leaves = [leaf for lane in frame.lanes for leaf in _leaf_lanes(lane)]
    depth = max((_depth(lane) for lane in frame.lanes), default=0)
    header = HEADER * (depth + (frame.kind == "participant"))
    if leaves:
        area, bands = _layers(nodes, links, _lane_numbers(nodes, links, leaves), len(leaves))
        frame.width, frame.height = header + area.width + 2 * _SIDE, area.height
        for box in area.boxes:
            put(box, box.x + header + _SIDE, box.y)
        _place_lanes(frame, leaves, bands)
    else:
        area = _stacked(nodes, links)
        top = _TOP if frame.kind != "participant" else HEADER
        for box in area.boxes:
            put(box, box.x + header + _SIDE, box.y + top)
        frame.width = max(header + area.width + 2 * _SIDE, 140)
        frame.height = max(area.height + top + HEADER, _BLACK_BOX if frame.kind == "participant" else 100)
    frame.x, frame.y = frame.width / 2, frame.height / 2


def _stacked(nodes: Sequence[LayoutBox], links: Sequence[LayoutLink]) -> Area:
    """A scope without lanes: its connected parts one below the other, then rows of what is connected to nothing."""
    parts, alone = _components(nodes, links)
    areas = []
    for part in parts:
        members = set(part)
        own = [link for link in links if _node(link.source) in members]
        areas.append(_layers(part, own, [0] * len(part), 0)[0])
    widest = max([_ROW_WIDTH, *(area.width for area in areas)])
    row: list[LayoutBox] = []
    for box in sorted(alone, key=lambda box: box.by_event):
        if row and (box.by_event != row[0].by_event or _across([*row, box]) > widest):
            areas.append(_row(row))
            row = []
        row.append(box)
    areas += [_row(row)] if row else []
    top, whole = 0.0, Area([], max((area.width for area in areas), default=0.0))
    for area in areas:
        for box in area.boxes:
            put(box, box.x, box.y + top)
        whole.boxes += area.boxes
        whole.height = top + area.height
        top = whole.height + _ROW_GAP
    return whole


def _node(end: LayoutBox | LayoutLink) -> LayoutBox | None:
    """The node of an end in the order of a scope: of a boundary event its host."""
    box = end if isinstance(end, LayoutBox) else None
    return box.host if box is not None and box.host is not None else box


def _components(
    nodes: Sequence[LayoutBox], links: Sequence[LayoutLink]
) -> tuple[list[list[LayoutBox]], list[LayoutBox]]:
    """The connected parts of a scope in the order of the file, and the nodes that are connected to nothing."""
    home = {box: [box] for box in nodes}
    linked = set[LayoutBox]()
    for link in links:
        source, target = _node(link.source), _node(link.target)
        if source not in home or target not in home or source is None or target is None:
            continue
        linked |= {source, target}
        if home[source] is not home[target]:
            home[source] += home[target]
            for box in home[target]:
                home[box] = home[source]
    place = {box: number for number, box in enumerate(nodes)}
    parts = {id(home[box]): sorted(home[box], key=place.__getitem__) for box in nodes if box in linked}
    return list(parts.values()), [box for box in nodes if box not in linked]


def _across(row: Sequence[LayoutBox]) -> float:
    return sum(box.reach[0] + box.reach[2] for box in row) + _ROW_GAP * (len(row) - 1)


def _row(row: Sequence[LayoutBox]) -> Area:
    """Boxes in a row: sub-processes aligned at the top, others centred."""
    left, up = 0.0, max(box.reach[1] for box in row)
    for box in row:
        put(box, left + box.reach[0], box.reach[1] if box.expanded else up)
        left += box.reach[0] + box.reach[2] + _ROW_GAP
    return Area(list(row), left - _ROW_GAP, max(box.y + box.reach[3] for box in row))


# ---- layers ----------------------------------------------------------------------------------------------------------


def _layers(
    nodes: Sequence[LayoutBox], links: Sequence[LayoutLink], lanes: Sequence[int], bands: int
) -> tuple[Area, list[tuple[float, float]]]:
    """Lay out connected nodes in columns and rows; also returns the bands of lanes."""
    number = {box: place for place, box in enumerate(nodes)}
    arcs, named = [], []
    for link in links:
        source, target = _node(link.source), _node(link.target)
        if source is None or target is None or source not in number or target not in number:
            continue
        guest = list(reversed(source.guests)).index(link.source) if link.source in source.guests else -1
        if source is not target or guest >= 0:
            arcs.append(Arc(number[source], number[target], guest, 16.0 if link.name else 0.0))
            named.append(link)
    if not nodes:
        return Area([]), [(place * _LANE, (place + 1) * _LANE) for place in range(bands)]
    found = layered(len(nodes), arcs, lanes)
    set_rows(found, [(box.reach[1], box.reach[3]) for box in nodes], bands, _LANE if bands else 0.0)
    _place_gateway_labels(found, nodes)
    set_rows(found, [(box.reach[1], box.reach[3]) for box in nodes], bands, _LANE if bands else 0.0)
    columns: list[list[LayoutBox]] = [[] for _ in found.columns]
    for box, vertex in zip(nodes, found.vertices, strict=False):
        columns[vertex.column].append(box)
    right = 0.0
    for place, column in enumerate(columns):
        left = right + (_gap(found, place - 1, nodes, arcs, named) if place else 0.0)
        right = _place_column(column, left, found, number)
    top = min(vertex.y - vertex.up for vertex in found.vertices) if not bands else 0.0
    for box in nodes:
        put(box, box.x, box.y - top)
    bottom = max(vertex.y + vertex.down for vertex in found.vertices) if not bands else found.bands[-1][1]
    return Area(list(nodes), right, bottom - top), found.bands


def _place_gateway_labels(found: Layers, nodes: Sequence[LayoutBox]) -> None:
    """Put the labels of gateways where no flow goes up or down."""
    rises, falls = set[int](), set[int]()
    for one, other, _ in found.segments:
        for at, to in ((one, other), (other, one)):
            rises |= {at} if found.vertices[to].y < found.vertices[at].y - 1 else set()
            falls |= {at} if found.vertices[to].y > found.vertices[at].y + 1 else set()
    falls |= {vertex.under for vertex in found.vertices}
    for place, box in enumerate(nodes):
        if box.kind.endswith("Gateway") and box.label is not None:
            _place_label(box, rises=place in rises, falls=place in falls)
            complete_node(box)


def _place_column(column: Sequence[LayoutBox], left: float, found: Layers, number: Mapping[LayoutBox, int]) -> float:
    """Place the nodes of a column around its middle, wide ones from its left end; gives its right end."""
    small = [box for box in column if box.reach[0] + box.reach[2] <= _SMALL] or column
    middle = left + max((_side(box, 0) for box in small), default=0.0)
    for box in column:
        x = middle if box in small else max(left + _side(box, 0), middle)
        put(box, x, found.vertices[number[box]].y)
    return max((box.x + _side(box, 2) for box in column), default=left)


def _side(box: LayoutBox, side: int) -> float:
    """How far a node extends to the left or right in its column; a label may be in the gap between columns."""
    is_label = box.label is not None and not box.artifacts
    return max(box.width / 2, box.reach[side] - _LABEL_IN_GAP) if is_label else box.reach[side]


def _gap(
    found: Layers, place: int, nodes: Sequence[LayoutBox], arcs: Sequence[Arc], named: Sequence[LayoutLink]
) -> float:
    """The distance between a column and the next: for labels of flows, and for the lines that go up or down there."""
    columns = [vertex.column for vertex in found.vertices]
    right = max((box.x + _side(box, 2) for box, at in zip(nodes, columns, strict=False) if at == place), default=0.0)
    width = _GAP
    for arc, link in zip(arcs, named, strict=True):
        if link.name and columns[arc.source] == place and arc.guest < 0:
            box = nodes[arc.source]
            width = max(width, label_room(link) - (right - box.x - box.width / 2))
    turning = set[int]()
    for one, other, _ in found.segments:
        at = min(columns[one], columns[other])
        corners = [nodes[end].kind.endswith("Gateway") for end in (one, other) if end < len(nodes)]
        if at == place and abs(found.vertices[one].y - found.vertices[other].y) > 1 and not any(corners):
            turning.add(min(one, other))
    return max(width, 30 + _TRACK * len(turning))


def label_room(link: LayoutLink) -> float:
    """Return how long a line must be to have its label above it."""
    return label_size(link.name)[0] + 20


# ---- lanes and pools -------------------------------------------------------------------------------------------------


def _leaf_lanes(lane: LayoutBox) -> list[LayoutBox]:
    return [leaf for inner in lane.lanes for leaf in _leaf_lanes(inner)] or [lane]


def _depth(lane: LayoutBox) -> int:
    return 1 + max((_depth(inner) for inner in lane.lanes), default=0)


def _lane_numbers(nodes: Sequence[LayoutBox], links: Sequence[LayoutLink], leaves: Sequence[LayoutBox]) -> list[int]:
    """The lane of each node, by number: of one without a lane that of a node that it is linked to, else the first."""
    numbers = {leaf.id: place for place, leaf in enumerate(leaves)}
    known = {box: numbers[box.lane] for box in nodes if box.lane in numbers}
    ends = [(source, target) for link in links if (source := _node(link.source)) and (target := _node(link.target))]
    for _ in nodes:
        missing = [(a, b) for pair in ends for a, b in (pair, pair[::-1]) if a in known and b not in known]
        if not missing:
            break
        known |= {b: known[a] for a, b in missing}
    return [known.get(box, 0) for box in nodes]


def _place_lanes(frame: LayoutBox, leaves: Sequence[LayoutBox], bands: Sequence[tuple[float, float]]) -> None:
    """Give each lane its band, and those around it the bands together."""
    place = {leaf.id: band for leaf, band in zip(leaves, bands, strict=True)}

    def set_lane(lane: LayoutBox, left: float) -> None:
        own = [place[leaf.id] for leaf in _leaf_lanes(lane)]
        top, bottom = own[0][0], own[-1][1]
        lane.width, lane.height = frame.width - left, bottom - top
        lane.x, lane.y = left + lane.width / 2, (top + bottom) / 2
        for inner in lane.lanes:
            set_lane(inner, left + HEADER)

    for lane in frame.lanes:
        set_lane(lane, HEADER if frame.kind == "participant" else 0.0)


def _order_pools(plane: Plane, links: Sequence[LayoutLink]) -> list[tuple[LayoutBox, LayoutBox]]:
    """Set the order of pools, and where message flows leave their nodes; gives the pools at the ends of each flow."""
    messages = ((link.source, link.target) for link in links if link.kind == "messageFlow")
    flows = [(a, b) for a, b in messages if isinstance(a, LayoutBox) and isinstance(b, LayoutBox)]
    flows = [(a, b) for a, b in flows if _pool_of(a) in plane.frames and _pool_of(b) in plane.frames]
    pairs = [(_pool_of(a), _pool_of(b)) for a, b in flows]
    plane.frames = _ordered(plane.frames, pairs)
    place = {pool: number for number, pool in enumerate(plane.frames)}
    for (a, b), (pool, other) in zip(flows, pairs, strict=True):
        down = place[pool] < place[other]
        a.falls, a.rises = a.falls or down, a.rises or not down
        b.falls, b.rises = b.falls or not down, b.rises or down
    return pairs


def stack(plane: Plane, pairs: Sequence[tuple[LayoutBox, LayoutBox]]) -> None:
    """Put pools below each other, all of one width, with room for message flows between."""
    width = max(600.0 if len(plane.frames) > 1 else 0.0, *(pool.width for pool in plane.frames))
    x, y = _START
    for pool in plane.frames:
        wider = width - pool.width if pool.kind == "participant" else 0.0
        for box in [pool, *_all_lanes(pool)]:
            box.width, box.x = box.width + wider, box.x + wider / 2
        pool.move(x, y)
        y += pool.height + _POOL_GAP + _TRACK * min(sum(pool in pair for pair in pairs), 8)
    if plane.loose:
        for box in plane.loose:
            complete_node(box)
        for box in _row(plane.loose).boxes:
            put(box, box.x + x, box.y + y)


def _all_lanes(box: LayoutBox) -> list[LayoutBox]:
    return [one for lane in box.lanes for one in (lane, *_all_lanes(lane))]


def _pool_of(box: LayoutBox) -> LayoutBox:
    return [box, *box.around()][-1]


def _ordered(pools: Sequence[LayoutBox], pairs: Sequence[tuple[LayoutBox, LayoutBox]]) -> list[LayoutBox]:
    """The order of few pools with the shortest message flows; among equal ones, and of many, that of the file."""
    if len(pools) > _MOST_ORDERED or not pairs:
        return list(pools)

    def length(order: Iterable[LayoutBox]) -> int:
        place = {pool: number for number, pool in enumerate(order)}
        return sum(abs(place[a] - place[b]) for a, b in pairs)

    return list(min(permutations(pools), key=length))
