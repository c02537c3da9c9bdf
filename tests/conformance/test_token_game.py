"""Random unstructured models beside a token game that knows nothing of FAME, and follows the standard word by word.

Loops lead back into forks, joins meet with whatever comes, links jump: nobody would draw these models, and their
meaning is defined all the same. The game is as simple as can be: tokens are numbers on sequence flows, whether an
inclusive join waits is found by walking the diagram (standard 13.4.3), and all is looked through at each step.
"""

import random
from collections import Counter, deque
from dataclasses import dataclass, field

import pytest
from engine_models import Run, catch, element, flow, gateway, link, model, path, start, throw, user

KINDS = ("task", "task", "user", "user", "parallel", "parallel", "exclusive", "inclusive", "inclusive", "link")
GATEWAYS = ("parallel", "exclusive", "inclusive")
MOST = 300
"""Steps of a game; a model that takes more goes round forever, perhaps."""


class Endless(Exception):
    """A game takes too long."""


@dataclass
class Graph:
    """`kinds` of elements by id, `flows` as pairs of them; `default` flows, and the `choices` of gateways in turn."""

    kinds: dict[str, str] = field(default_factory=lambda: {"s": "task"})
    flows: list[tuple[str, str]] = field(default_factory=list)
    choices: dict[str, list[int]] = field(default_factory=dict)

    def out(self, id: str) -> list[tuple[str, str]]:
        return [each for each in self.flows if each[0] == id]

    def into(self, id: str) -> list[tuple[str, str]]:
        return [each for each in self.flows if each[1] == id]


def drawn(seed: int) -> Graph:
    """A random graph in which everything is reached from ``s``."""
    dice, graph = random.Random(seed), Graph()
    open_ends = ["s"] * dice.choice((1, 1, 2))
    for number in range(dice.randint(4, 14)):
        if open_ends:
            id, kind = f"n{number}", dice.choice(KINDS)
            graph.kinds[id] = kind
            graph.flows.append((open_ends.pop(dice.randrange(len(open_ends))), id))
            open_ends += [id] * (dice.randint(1, 3) if kind in GATEWAYS else 1)
            graph.choices[id] = [dice.randrange(8) for _ in range(dice.randint(1, 4))]
    for id in open_ends:
        joins = [other for other, kind in graph.kinds.items() if kind in GATEWAYS and other != id]
        target = dice.choice(joins or ["end"]) if dice.random() < 0.7 else "end"
        if (id, target) not in graph.flows:
            graph.flows.append((id, target))
    graph.kinds["end"] = "task"
    return graph


def chosen(graph: Graph, id: str, times: int) -> list[tuple[str, str]]:
    """The flows that a gateway takes when it is passed for the n-th time; the last one is its default."""
    ways, number = graph.out(id), graph.choices.get(id, [0])[times % len(graph.choices.get(id, [0]))]
    if graph.kinds[id] == "exclusive" and ways:
        return [ways[number % len(ways)]]
    if graph.kinds[id] == "inclusive" and len(ways) > 1:
        return [way for place, way in enumerate(ways[:-1]) if number >> place & 1] or ways[-1:]
    return ways


def as_bpmn(graph: Graph) -> str:
    """The same as BPMN: gateways count in ``n`` how often they chose."""
    content = []
    for id, kind in graph.kinds.items():
        ways = graph.out(id)
        default = {"default": "_".join(ways[-1])} if kind in GATEWAYS[1:] and len(ways) > 1 else {}
        made = {"task": element("task", id), "user": user(id), "link": throw(id, link(id)) + catch(f"{id}c", link(id))}
        content.append(start("s") if id == "s" else made.get(kind) or gateway(kind, id, **default))
        if kind == "link" and len(ways) == 1:
            content.append(path(f"{id}c {ways[0][1]}"))
            continue
        for place, (_, target) in enumerate(ways):
            number = f"{graph.choices.get(id)}[n['{id}'] % {len(graph.choices.get(id, ''))}]"
            test = f"{number} % {len(ways)} == {place}" if kind == "exclusive" else f"{number} >> {place} & 1"
            count = f"n.update({id}=n.get('{id}', -1) + 1) or " if place == 0 else ""
            asked = default and place < len(ways) - 1
            content.append(flow(id, target, f"{count}({test})" if asked else ""))
    return "".join(content)


class Game:
    """Tokens on flows (`held`, at joins), at users, and on their way (`ready`: where each comes to, and along what)."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.visits, self.steps = graph, Counter[str](), 0
        self.held, self.order = Counter[tuple[str, str]](), dict[str, None]()
        self.users, self.ready = list[str](), deque([("s", ("", "s"))])
        self.play()

    def play(self) -> None:
        while self.ready or self.decide():
            place, along = self.ready.popleft()
            while place:
                self.steps += 1
                if self.steps > MOST:
                    raise Endless
                place, along = self.come(place, along)

    def come(self, id: str, along: tuple[str, str]) -> tuple[str, tuple[str, str]]:
        kind, ways = self.graph.kinds[id], self.graph.into(id)
        if kind in ("parallel", "inclusive") and len(ways) > 1:
            self.held[along] += 1
            if kind == "inclusive":
                self.order[id] = None
            if kind == "inclusive" or not all(self.held[way] for way in ways):
                return "", along
            self.held.subtract(ways)
        if kind == "user":
            self.users.append(id)
            return "", along
        return self.leave(id)

    def leave(self, id: str) -> tuple[str, tuple[str, str]]:
        ways = chosen(self.graph, id, self.visits[id])
        self.visits[id] += 1
        self.ready.extend((target, (id, target)) for _, target in ways[1:])
        return (ways[0][1], ways[0]) if ways else ("", ("", ""))

    def complete(self, id: str) -> None:
        self.users.remove(id)
        place, along = self.leave(id)
        self.ready.append((place, along)) if place else None
        self.play()

    def decide(self) -> bool:
        """Let the first inclusive join through that has to wait for nothing."""
        for join in self.order:
            ways = self.graph.into(join)
            filled = {way for way in ways if self.held[way]}
            places = [[way] for way, count in self.held.items() if count and way not in filled]
            places += [self.graph.out(id) for id in self.users]
            reached = [self.walk(place, join) for place in places]
            if all(found <= filled or found & filled for found in reached):
                self.held.subtract(filled)
                del self.order[join]
                if any(self.held[way] for way in ways):
                    self.order[join] = None
                place, along = self.leave(join)
                self.ready.append((place, along)) if place else None
                return bool(self.ready) or self.decide()
        return False

    def walk(self, place: list[tuple[str, str]], join: str) -> set[tuple[str, str]]:
        """The flows into a join that can be reached from some flows without passing it."""
        seen, pending = set[tuple[str, str]](), list(place)
        while pending:
            way = pending.pop()
            if way not in seen:
                seen.add(way)
                pending += [] if way[1] == join else self.graph.out(way[1])
        return {way for way in seen if way[1] == join}


@pytest.mark.long_but("*-0")
@pytest.mark.parametrize("part", range(16))
@pytest.mark.parametrize("after", ["straight", "restored", "recorded"])
def test_unstructured_models_go_as_the_tokens_of_the_standard_do(after: str, part: int) -> None:
    played = 0
    for seed in range(part, 400, 16):
        graph, dice = drawn(seed), random.Random(seed)
        try:
            game = Game(graph)
            run = Run(model(as_bpmn(graph)), {"n": {}}, after=after).run()
            for _ in range(10):
                visits = Counter({id: count for id, count in run.visits.items() if not id.endswith("c")})
                assert visits == +game.visits, f"seed {seed}"
                assert sorted(id for id in run.waiting if graph.kinds[id] == "user") == sorted(game.users)
                if not game.users:
                    assert run.status == ("running" if any(game.held.values()) else "completed")
                    break
                id = dice.choice(game.users)
                game.complete(id)
                run.complete(id)
            played += 1
        except Endless:
            continue
    assert played > 15
