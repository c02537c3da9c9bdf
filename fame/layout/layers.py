"""Places the nodes of a directed graph in columns and rows: the method of Sugiyama, Tagawa and Toda (1981).

1. Cycles are removed by depth-first search: an arc to a node that is still being visited points back.
2. A node's column is the length of the longest path to it; a further source stands beside what it leads to.
3. Arcs over several columns get a dummy node in each. The order within columns is improved by barycentres, first to
   last column and back, and the order with the fewest crossings is kept.
4. Rows are straight where they can be: arcs are aligned one after the other, those of the longest path first, unless
   an arc that is aligned already is in the way (linear segments, Sander 1996; the priority is the main path instead of
   the number of dummies). The aligned segments are packed from above, then drawn to the median of their neighbours.

Constraints of BPMN: nodes keep the order of their lanes; the way out of a boundary event begins below its host, that of
the rightmost event first, so that these ways do not cross. Arcs that point back order nothing: they are only routed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from statistics import median_low
from typing import NamedTuple

from fame.dataclasses import dataclass, field

NODE_GAP, LINE_GAP = 30.0, 15.0
"""Between two nodes of a column, and between a node and a line that passes (px)."""
BAND = 30.0
"""Between what is in a lane and its border (px)."""
_HALF_ROW = 40.0
"""Half of the least height of a row: that of a task, so that rows have even distances (px)."""
_SWEEPS = 12


class Arc(NamedTuple):
    """An arc between nodes, by number. `guest`: the place of its boundary event from the right, -1 for none; `label`:
    the height of its label (px)."""

    source: int
    target: int
    guest: int = -1
    label: float = 0.0


@dataclass(slots=True, eq=False)
class Vertex:
    """A node or a dummy of an arc. `lane` is the place of its lane, `y` the middle of its row (px)."""

    column: int
    lane: int
    up: float
    down: float
    node: int = -1
    under: int = -1
    guest: int = -1
    block: int = -1
    y: float = 0.0


@dataclass(slots=True)
class Layers:
    """A graph in columns of vertices, from above; the first vertices are the nodes. `bands`: the ends of each lane."""

    vertices: list[Vertex]
    columns: list[list[int]] = field(default_factory=list)
    segments: list[tuple[int, int, float]] = field(default_factory=list)
    bands: list[tuple[float, float]] = field(default_factory=list)


def layered(count: int, arcs: Sequence[Arc], lanes: Sequence[int]) -> Layers:
    """Return a graph of `count` nodes with the column and the order of each; rows are set by `set_rows`."""
    back = _pointing_back(count, arcs)
    forward = [arc for number, arc in enumerate(arcs) if number not in back]
    columns, remaining = _columns(count, forward)
    found = Layers([Vertex(columns[node], lanes[node], 0, 0, node) for node in range(count)])
    first = set(range(count)) - {arc.target for arc in forward}
    usual = _reached(first, [arc for arc in forward if arc.guest < 0])
    chains: dict[tuple[int, int], int] = {}
    for arc in forward:
        aside = arc.guest >= 0 or arc.source not in usual
        _add_chain(found, arc, columns[arc.source] + 1 + remaining[arc.target] - 1e3 * aside, chains)
    _order(found, remaining)
    return found


def _pointing_back(count: int, arcs: Sequence[Arc]) -> set[int]:
    """The arcs to a node that the search is still below of; it begins at the nodes without an incoming arc."""
    leaving: list[list[int]] = [[] for _ in range(count)]
    entered = [False] * count
    for place, arc in enumerate(arcs):
        leaving[arc.source].append(place)
        entered[arc.target] = True
    state, back = [0] * count, set[int]()
    number: int | None
    for root in sorted(range(count), key=lambda node: entered[node]):
        if state[root]:
            continue
        state[root], stack = 1, [(root, iter(leaving[root]))]
        while stack:
            node, rest = stack[-1]
            number = next(rest, None)
            if number is None:
                state[node] = 2
                stack.pop()
            elif state[target := arcs[number].target] == 1:
                back.add(number)
            elif not state[target]:
                state[target] = 1
                stack.append((target, iter(leaving[target])))
    return back


def _columns(count: int, arcs: Sequence[Arc]) -> tuple[list[int], list[int]]:
    """The column of each node, and the length of the longest path from there."""
    order = _topological(count, [(arc.source, arc.target) for arc in arcs])
    leaving: list[list[int]] = [[] for _ in range(count)]
    entered = [False] * count
    for arc in arcs:
        leaving[arc.source].append(arc.target)
        entered[arc.target] = True
    columns, remaining = [0] * count, [0] * count
    for node in order:
        for target in leaving[node]:
            columns[target] = max(columns[target], columns[node] + 1)
    for node in reversed(order):
        remaining[node] = max((remaining[target] + 1 for target in leaving[node]), default=0)
    longest = max(remaining, default=0)
    for node in range(count):
        if not entered[node] and leaving[node] and remaining[node] < longest:
            columns[node] = min(columns[target] for target in leaving[node]) - 1
    return columns, remaining


def _reached(first: Iterable[int], arcs: Iterable[Arc]) -> set[int]:
    """The nodes that are reached by these arcs from the first nodes of all."""
    leaving: defaultdict[int, list[int]] = defaultdict(list)
    for arc in arcs:
        leaving[arc.source].append(arc.target)
    stack = list(first)
    reached = set(stack)
    while stack:
        fresh = [target for target in leaving[stack.pop()] if target not in reached]
        reached.update(fresh)
        stack += fresh
    return reached


def _topological(count: int, pairs: Iterable[tuple[int, int]]) -> list[int]:
    """The nodes of an acyclic graph, each after its predecessors (Kahn 1962)."""
    after: list[list[int]] = [[] for _ in range(count)]
    missing = [0] * count
    for source, target in pairs:
        after[source].append(target)
        missing[target] += 1
    order = [node for node in range(count) if not missing[node]]
    for node in order:
        for target in after[node]:
            missing[target] -= 1
            if not missing[target]:
                order.append(target)
    return order


def _add_chain(found: Layers, arc: Arc, priority: float, chains: dict[tuple[int, int], int]) -> None:
    """Add an arc as segments over dummies; one that leaves a boundary event begins below its host.

    Arcs with the same target share their dummies (`chains`: by target and column): they run into one line.
    """
    source, target = found.vertices[arc.source], found.vertices[arc.target]
    ends = [arc.source] if arc.guest < 0 else []
    for column in range(source.column + (arc.guest < 0), target.column):
        below = column == source.column
        if not below and (arc.target, column) in chains:
            ends.append(chains[arc.target, column])
            break
        dummy = Vertex(column, source.lane if below else target.lane, 5 + arc.label, 5)
        if below:
            dummy.under, dummy.guest = arc.source, arc.guest
        else:
            chains[arc.target, column] = len(found.vertices)
        ends.append(len(found.vertices))
        found.vertices.append(dummy)
    else:
        ends.append(arc.target)
    found.segments += [(one, other, priority) for one, other in pairwise(ends)]


# ---- order within columns --------------------------------------------------------------------------------------------


def _order(found: Layers, remaining: Sequence[int]) -> None:
    """Set the order: first as a depth-first search meets the vertices, the longest way first, then by barycentres."""
    leaving: defaultdict[int, list[int]] = defaultdict(list)
    for one, other, _ in sorted(found.segments, key=lambda segment: -segment[2]):
        leaving[one].append(other)
    for number, vertex in enumerate(found.vertices):
        if vertex.under >= 0:
            leaving[vertex.under].append(number)
    found.columns = [[] for _ in range(max(vertex.column for vertex in found.vertices) + 1)]
    seen = set[int]()
    roots = sorted(range(len(remaining)), key=lambda node: (found.vertices[node].column, node))
    for root in [*roots, *range(len(remaining), len(found.vertices))]:
        stack = [root]
        while stack:
            number = stack.pop()
            if number not in seen:
                seen.add(number)
                found.columns[found.vertices[number].column].append(number)
                stack += reversed(leaving[number])
    found.columns = [_constrained(found, column) for column in found.columns]
    best, fewest = found.columns, _crossings(found, found.columns)
    for sweep in range(_SWEEPS if fewest else 0):
        _sweep(found, forward=sweep % 2 == 0)
        crossings = _crossings(found, found.columns)
        if crossings < fewest:
            best, fewest = list(found.columns), crossings
    found.columns = best


def _constrained(found: Layers, column: Iterable[int]) -> list[int]:
    """A column in the order of lanes, with the dummies that begin below a node right after it."""
    below: defaultdict[int, list[int]] = defaultdict(list)
    rest = []
    for number in column:
        vertex = found.vertices[number]
        if vertex.under >= 0:
            below[vertex.under].append(number)
        else:
            rest.append(number)
    for dummies in below.values():
        dummies.sort(key=lambda number: found.vertices[number].guest)
    rest.sort(key=lambda number: found.vertices[number].lane)
    return [one for number in rest for one in (number, *below.get(number, ()))]


def _sweep(found: Layers, *, forward: bool) -> None:
    """Sort each column by the mean place of its neighbours in the columns before it (or after it)."""
    near: defaultdict[int, list[int]] = defaultdict(list)
    for one, other, _ in found.segments:
        near[other if forward else one].append(one if forward else other)
    places = {number: place for column in found.columns for place, number in enumerate(column)}
    numbers = range(len(found.columns))
    for at in numbers if forward else reversed(numbers):
        means = {}
        for place, number in enumerate(found.columns[at]):
            others = [places[other] for other in near[number]]
            means[number] = sum(others) / len(others) if others else place
        column = _constrained(found, sorted(found.columns[at], key=means.__getitem__))
        found.columns = [*found.columns[:at], column, *found.columns[at + 1 :]]
        places.update((number, place) for place, number in enumerate(column))


def _crossings(found: Layers, columns: Sequence[Sequence[int]]) -> int:
    """The number of crossings between segments."""
    places = {number: place for column in columns for place, number in enumerate(column)}
    gaps: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
    for one, other, _ in found.segments:
        gaps[found.vertices[one].column].append((places[one], places[other]))
    count = 0
    for pairs in gaps.values():
        pairs.sort()
        count += sum(b < a for number, (x, a) in enumerate(pairs) for y, b in pairs[number + 1 :] if y > x)
    return count


# ---- rows ------------------------------------------------------------------------------------------------------------


def set_rows(found: Layers, reaches: Sequence[tuple[float, float]], lanes: int, least: float) -> None:
    """Set the row of each vertex, and the bands of lanes, each at least `least` high.

    `reaches`: how far each node extends upwards and downwards from the middle of its row. May be called again.
    """
    for vertex, (up, down) in zip(found.vertices, reaches, strict=False):
        vertex.up, vertex.down = max(up, _HALF_ROW), max(down, _HALF_ROW)
    blocks = _aligned(found)
    above, below = _neighbours(found)
    tops, found.bands = [0.0] * len(blocks), []
    order = _topological(len(blocks), ((one, other) for one, others in enumerate(below) for other in others))
    floor = 0.0
    for lane in range(max(lanes, 1)):
        inside = [block for block in order if found.vertices[blocks[block][0]].lane == lane]
        edge = BAND if lanes else 0.0
        for block in inside:
            highest = floor + edge + max(found.vertices[number].up for number in blocks[block])
            tops[block] = max([highest, *(tops[other] + apart for other, apart in above[block].items())])
        deep = [tops[block] + max(found.vertices[number].down for number in blocks[block]) for block in inside]
        bottom = max([floor + least, *(bottom + edge for bottom in deep)])
        found.bands.append((floor, bottom))
        floor = bottom
    _balance(found, blocks, order, tops, (above, below), BAND if lanes else 0.0)
    for block, numbers in enumerate(blocks):
        for number in numbers:
            found.vertices[number].y = tops[block]


def _aligned(found: Layers) -> list[list[int]]:
    """The vertices in blocks that have one row each; sets the block of each vertex."""
    blocks = [[number] for number in range(len(found.vertices))]
    for number, vertex in enumerate(found.vertices):
        vertex.block = number
    below: list[set[int]] = [set() for _ in blocks]
    for column in found.columns:
        for one, other in pairwise(column):
            below[one].add(other)
    above: list[set[int]] = [set() for _ in blocks]
    for one, others in enumerate(below):
        for other in others:
            above[other].add(one)
    real = [vertex.node >= 0 for vertex in found.vertices]
    ranked = sorted(found.segments, key=lambda segment: (-segment[2], real[segment[0]] + real[segment[1]]))
    for one, other, _ in ranked:
        a, b = found.vertices[one].block, found.vertices[other].block
        if a == b or found.vertices[one].lane != found.vertices[other].lane:
            continue
        columns = {found.vertices[number].column for number in blocks[a]}
        if any(found.vertices[number].column in columns for number in blocks[b]):
            continue
        if _leads(below, a, b) or _leads(below, b, a):
            continue
        for number in blocks[b]:
            found.vertices[number].block = a
        blocks[a] += blocks[b]
        blocks[b] = []
        for ways, opposite in ((below, above), (above, below)):
            for near in ways[b]:
                opposite[near].discard(b)
                opposite[near].add(a)
            ways[a] |= ways[b]
            ways[b] = set()
    kept = [numbers for numbers in blocks if numbers]
    for block, numbers in enumerate(kept):
        for number in numbers:
            found.vertices[number].block = block
    return kept


def _leads(ways: Sequence[set[int]], start: int, end: int) -> bool:
    """Whether there is a path between two blocks."""
    stack, seen = [start], {start}
    while stack:
        for near in ways[stack.pop()]:
            if near == end:
                return True
            if near not in seen:
                seen.add(near)
                stack.append(near)
    return False


def _neighbours(found: Layers) -> tuple[list[dict[int, float]], list[dict[int, float]]]:
    """The blocks above and below each block, with the least distance of their rows (px)."""
    count = max(vertex.block for vertex in found.vertices) + 1
    above: list[dict[int, float]] = [{} for _ in range(count)]
    below: list[dict[int, float]] = [{} for _ in range(count)]
    for column in found.columns:
        for one, other in pairwise(found.vertices[number] for number in column):
            gap = NODE_GAP if one.node >= 0 and other.node >= 0 else LINE_GAP
            apart = max(one.down + gap + other.up, below[one.block].get(other.block, 0.0))
            above[other.block][one.block] = below[one.block][other.block] = apart
    return above, below


def _balance(
    found: Layers,
    blocks: Sequence[Sequence[int]],
    order: Sequence[int],
    tops: list[float],
    around: tuple[Sequence[Mapping[int, float]], Sequence[Mapping[int, float]]],
    edge: float,
) -> None:
    """Draw each block to the median of the rows that it is connected to, as far as there is room."""
    linked: list[list[int]] = [[] for _ in blocks]
    for one, other, _ in found.segments:
        a, b = found.vertices[one].block, found.vertices[other].block
        if a != b:
            linked[a].append(b)
            linked[b].append(a)
    for turn in range(4):
        for block in reversed(order) if turn % 2 == 0 else order:
            if linked[block]:
                tops[block] = _clamped(found, blocks[block], block, tops, around, edge, linked[block])


def _clamped(
    found: Layers,
    numbers: Sequence[int],
    block: int,
    tops: Sequence[float],
    around: tuple[Sequence[Mapping[int, float]], Sequence[Mapping[int, float]]],
    edge: float,
    linked: Sequence[int],
) -> float:
    above, below = around
    top, bottom = found.bands[found.vertices[numbers[0]].lane]
    up = max(found.vertices[number].up for number in numbers)
    down = max(found.vertices[number].down for number in numbers)
    low = max([top + edge + up, *(tops[other] + apart for other, apart in above[block].items())])
    high = min([bottom - edge - down, *(tops[other] - apart for other, apart in below[block].items())])
    wanted: float = median_low([tops[other] for other in linked])
    return max(low, min(high, wanted))
