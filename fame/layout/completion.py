"""Completes a diagram: what has a place keeps it, what has none is placed where there is room.

A node stands beside a node that it is linked to, else at the nearest free place of its scope or lane. A pool or
sub-process without room for it grows to the right, or downwards if something stands there. A pool that is not drawn
comes below everything, the content of a collapsed sub-process on a plane of its own, as in Camunda Modeler.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from fame.bpmn.draw.svg import Obstacles, Point
from fame.bpmn.model import Bounds, Definitions
from fame.dataclasses import dataclass
from fame.layout.arrange import (
    HEADER,
    arrange_frame,
    by_scope,
    complete_node,
    place_guest_label,
    put,
    stack,
)
from fame.layout.connect import room_of
from fame.layout.content import (
    ARTIFACTS,
    BODIES,
    DiagramContent,
    LayoutBox,
    LayoutLink,
    Plane,
)

_CLEAR, _ASIDE, _ROW, _STEP, _OUTSIDE = 12.0, 50.0, 110.0, 30.0, 200.0


def complete(content: DiagramContent, definitions: Definitions) -> None:
    """Set the place of everything that has none in the diagrams of a file."""
    planes = {plane.element: plane for plane in content.planes}
    keep_places(content, definitions)
    inside, found = by_scope(content.links), list[Plane]()
    for element in definitions.planes:
        box = content.boxes.get(element)
        hidden = _hidden(box) if box is not None and box.kind in BODIES else Plane(element, [], [])
        found.append(planes.pop(element, hidden))
    work = _Completion(content.links, inside, found)
    for number, plane in enumerate(list(found)):
        work.fill_plane(plane, number)
    for plane in planes.values():
        for frame in plane.frames:
            arrange_frame(frame, inside)
        stack(plane, [])
    content.planes = [*found, *planes.values()]


def keep_places(content: DiagramContent, definitions: Definitions) -> None:
    """Set the places that elements have in a diagram."""
    open_ones = {shape.element for shape in definitions.shapes if shape.expanded}
    for shape in definitions.shapes:
        box = content.boxes.get(shape.element)
        if box is None or box.placed:
            continue
        bounds = shape.bounds
        box.x, box.y = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2
        box.width, box.height, box.placed, label = bounds.width, bounds.height, True, shape.label
        box.label = None
        if label is not None and label.width:
            box.label = Bounds(label.x - box.x, label.y - box.y, label.width, label.height)
    links = {link.id: link for link in content.links}
    for edge in definitions.edges:
        if (link := links.get(edge.element)) is not None:
            link.waypoints, link.label = list(edge.waypoints), edge.label
    at = {shape.element: shape.plane for shape in definitions.shapes}
    for box in content.boxes.values():
        if box.kind in BODIES and box.placed and box.id not in open_ones:
            box.expanded = any(at.get(child.id) == at[box.id] for child in box.children)


def _hidden(box: LayoutBox) -> Plane:
    """The plane of what a collapsed sub-process has inside, which is no longer drawn in its shape."""
    inner = LayoutBox(box.id, "process", box.name, children=box.children, expanded=True)
    for child in inner.children:
        child.parent = inner
    box.children = []
    return Plane(box.id, [inner], [])


@dataclass(slots=True)
class _Completion:
    """The work on one file: its links, those that order each scope, and its planes, to which those of collapsed
    sub-processes are added."""

    links: Sequence[LayoutLink]
    inside: Mapping[LayoutBox, list[LayoutLink]]
    planes: list[Plane]

    def fill_plane(self, plane: Plane, number: int) -> None:
        """Place what is missing on a plane; a pool that is missing comes below everything."""
        boxes = [box for frame in plane.frames for box in (frame, *frame.inner())] + plane.loose
        placed = [box.bounds for box in boxes if box.placed]
        if not placed:
            for frame in plane.frames:
                arrange_frame(frame, self.inside)
            return stack(plane, []) if plane.frames else None
        bottom = max(box.y + box.height for box in placed)
        for frame in plane.frames:
            if frame.kind != "participant" or (not frame.placed and any(child.placed for child in frame.children)):
                _enclose(frame)
            if frame.placed:
                if any(child.placed for child in frame.children):
                    _divide(frame, frame)
                self._fill(frame)
            else:
                arrange_frame(frame, self.inside)
                frame.width = max(frame.width, 600.0)
                frame.x = frame.width / 2
                frame.move(min(box.x for box in placed), bottom + _ASIDE)
                bottom = frame.y + frame.height / 2
        for box in plane.loose:
            if not box.placed:
                complete_node(box)
                put(box, min(one.x for one in placed) + box.reach[0], bottom + _ASIDE + box.reach[1])
                bottom = box.y + box.height / 2
        return None

    def _fill(self, frame: LayoutBox) -> None:
        """Place what is missing in a pool, process or sub-process."""
        for child in frame.children:
            if child.placed and child.expanded:
                self._fill(child)
            elif child.placed and child.children:
                plane = _hidden(child)
                self.planes.append(plane)
                arrange_frame(plane.frames[0], self.inside)
                stack(plane, [])
        missing = [child for child in frame.children if not child.placed]
        if missing and len(missing) == len(frame.children) and not any(lane.placed for lane in frame.lanes):
            self._fill_empty(frame)
            return
        for box in sorted(missing, key=lambda box: box.kind in ARTIFACTS):
            if box.host is None or box.kind in ARTIFACTS:
                self._place(box, frame)
        for box in missing:
            if box.host is not None and box.kind == "boundaryEvent":
                _attach(box, box.host, self._taken(frame))

    def _fill_empty(self, frame: LayoutBox) -> None:
        """Lay out a frame without content as if it was new, and let it grow until that fits."""
        bounds = frame.bounds
        arrange_frame(frame, self.inside)
        frame.move(bounds.x, bounds.y)
        _grow(frame, bounds.x + bounds.width, bounds.y + bounds.height)

    def _place(self, box: LayoutBox, frame: LayoutBox) -> None:
        """Place one node in its scope."""
        if box.expanded:
            arrange_frame(box, self.inside)
        for guest in box.guests:
            _attach(guest, box, Obstacles())
        complete_node(box, artifacts=False)
        lanes = {lane.id: lane for lane in _lanes(frame)}
        lane = lanes.get(box.lane)
        room = room_of(frame if lane is None or not lane.placed else lane)
        wanted = list(self._beside(box)) or [
            (room.x + box.reach[0] + _STEP, room.y + room.height - box.reach[3] - _STEP)
        ]
        taken = self._taken(frame)
        fits = (spot for spot in _spots(wanted, room) if _is_free(box, spot, room, taken))
        spot = next(fits, None)
        if spot is None:
            spot = _outside(box, wanted[0], frame, room, taken)
        by = spot[0] - box.x, spot[1] - box.y
        for part in (box, *box.guests):
            part.move(*by)
            part.placed = True
        right, bottom = box.x + box.reach[2] + _STEP, box.y + box.reach[3] + _STEP
        _grow(frame, right, bottom)

    def _beside(self, box: LayoutBox) -> Iterator[Point]:
        """The places beside the placed nodes that a node is linked to."""
        for link in self.links:
            for one, other, way in ((link.source, link.target, -1), (link.target, link.source, 1)):
                if (
                    one is not box
                    or not isinstance(other, LayoutBox)
                    or not other.placed
                    or other.parent is not box.parent
                ):
                    continue
                if box.kind in ARTIFACTS:
                    yield other.x, other.y - other.height / 2 - _STEP - box.reach[3]
                    yield other.x, other.y + other.height / 2 + _STEP + box.reach[1]
                else:
                    apart = other.width / 2 + _ASIDE + box.reach[0 if way == 1 else 2]
                    yield other.x + way * apart, other.y

    def _taken(self, frame: LayoutBox) -> Obstacles:
        """What is in a scope already."""
        boxes = [box for child in frame.children if child.placed for box in (child.bounds, child.label_bounds) if box]
        lines = [line for link in self.links for line in pairwise(link.waypoints)]
        return Obstacles(boxes, lines)


def _lanes(box: LayoutBox) -> Iterator[LayoutBox]:
    for lane in box.lanes:
        yield lane
        yield from _lanes(lane)


def _divide(box: LayoutBox, pool: LayoutBox) -> None:
    """Draw the lanes of a pool or lane that has none drawn, each around what it has, if what is drawn allows that."""
    lanes, frame = box.lanes, box.bounds
    if frame.height and lanes and not any(lane.placed for lane in lanes):
        held = [{each.id for each in (lane, *_lanes(lane))} for lane in lanes]
        nodes = [[one.bounds for one in pool.children if one.placed and one.lane in ids] for ids in held]
        top, end, left = frame.y, frame.y + frame.height, HEADER if box.kind != "process" else 0.0
        for number, lane in enumerate(lanes, 1):
            low = max((one.y + one.height for some in nodes[:number] for one in some), default=top)
            high = min((one.y for some in nodes[number:] for one in some), default=end)
            wanted = frame.y + frame.height * number / len(lanes)
            bottom = end if number == len(lanes) else max(top, min(max(wanted, low), high) if low <= high else wanted)
            lane.width, lane.height, lane.placed = frame.width - left, bottom - top, True
            lane.x, lane.y, top = frame.x + left + lane.width / 2, (top + bottom) / 2, bottom
    for lane in lanes:
        _divide(lane, pool)


def _enclose(frame: LayoutBox) -> None:
    """Draw a frame without bounds around what is in it."""
    boxes = [child.bounds for child in frame.children if child.placed]
    if boxes:
        left, top = min(box.x for box in boxes) - _OUTSIDE, min(box.y for box in boxes) - _OUTSIDE
        right, bottom = max(box.x + box.width for box in boxes), max(box.y + box.height for box in boxes)
        frame.width, frame.height = right + 2 * _OUTSIDE - left, bottom + 2 * _OUTSIDE - top
        frame.x, frame.y, frame.placed = left + frame.width / 2, top + frame.height / 2, True


def _spots(wanted: Sequence[Point], room: Bounds) -> Iterator[Point]:
    """Places to try: those wanted, then rows below and above them, then everywhere, the nearest first."""
    yield from wanted
    x, y = wanted[0]
    yield from ((x, y + way * rows * _ROW) for rows in range(1, 4) for way in (1, -1))
    across, down = (range(int(extent // _STEP) + 1) for extent in (room.width, room.height))
    places = [(room.x + _STEP * column, room.y + _STEP * row) for row in down for column in across]
    yield from sorted(places, key=lambda place: abs(place[0] - x) + 2 * abs(place[1] - y))


def _is_free(box: LayoutBox, spot: Point, room: Bounds, taken: Obstacles) -> bool:
    left, up, right, down = (reach + _CLEAR for reach in box.reach)
    x, y = spot[0] - left, spot[1] - up
    inside = room.x <= x and room.y <= y and x + left + right <= room.x + room.width
    inside = inside and y + up + down <= room.y + room.height
    return inside and not taken.count(Bounds(x, y, left + right, up + down))


def _outside(box: LayoutBox, wanted: Point, frame: LayoutBox, room: Bounds, taken: Obstacles) -> Point:
    """A place right of the room or below it, where the frame runs into nothing when it grows."""
    right = room.x + room.width + box.reach[0] + _STEP, max(wanted[1], room.y + box.reach[1] + _STEP)
    below = max(wanted[0], room.x + box.reach[0] + _STEP), room.y + room.height + box.reach[1] + _STEP
    blocked = [Bounds(one.x - _STEP, one.y, one.width + _STEP, one.height) for one in _siblings(frame)]
    grown = Bounds(room.x + room.width, room.y, box.reach[0] + box.reach[2] + 2 * _STEP, room.height)
    return right if not Obstacles(blocked).count(grown) else below


def _siblings(frame: LayoutBox) -> Iterator[Bounds]:
    for box in frame.parent.children if frame.parent is not None else ():
        if box is not frame and box.host is not frame and box.placed:
            yield box.bounds


def _grow(frame: LayoutBox, right: float, bottom: float) -> None:
    """Extend a frame, its lanes and all around it to a right and a lower end; boundary events stay on the border."""
    for box in (frame, *frame.around()):
        if box.kind == "process":
            continue
        wider = max(0.0, right - box.x - box.width / 2)
        higher = max(0.0, bottom - box.y - box.height / 2)
        for one in (box, *(lane for lane in _lanes(box) if lane.placed)):
            last = one is box or one.y + one.height / 2 >= box.y + box.height / 2 - 1
            one.width, one.x = one.width + wider, one.x + wider / 2
            one.height, one.y = (one.height + higher, one.y + higher / 2) if last else (one.height, one.y)
        for guest in box.guests:
            below = abs(guest.y - (box.y + box.height / 2 - higher)) < 1
            guest.y += higher if below else 0.0
        right, bottom = right + _STEP, bottom + _STEP


def _attach(event: LayoutBox, host: LayoutBox, taken: Obstacles) -> None:
    """Put a boundary event on the lower border of its host, from the right, where it and its label cover least."""
    others = [guest.bounds for guest in host.guests if guest.placed and guest is not event]
    event.y, event.placed = host.y + host.height / 2, True
    place_guest_label(event)
    most, found = float("inf"), host.x
    for by in range(28, max(int(host.width) - 17, 29), 10):
        event.x = host.x + host.width / 2 - by
        count = 10 * Obstacles(others).count(event.bounds)
        count += taken.count(label) if (label := event.label_bounds) is not None else 0
        if count < most:
            most, found = count, event.x
    event.x = found
