"""Scripts made at random, with aliases, changes in place and exceptions, beside a run of them by a real engine.

``python -m tests.sliced_scripts 0 5000`` looks at so many, and prints those whose exploration denies what a run does.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from html import escape
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from bpmn_text import extensions, process

import fame
from fame.errors import FameError
from fame.properties.grammar import parse
from fame.properties.sentence import NOWHERE
from fame.scenario.explore.exploration import explore

VALUES = """[] ~ [1] ~ [V] ~ [V, V] ~ V ~ V ~ V ~ {'k': V} ~ dict(k=V) ~ V[0] ~ V['k'] ~ V or E ~ E if V else V
 ~ (V := E)

 ~ [x for x in V] ~ list(V) ~ V + E ~ [V] * 2 ~ max(V, E) ~ (V, E) ~ {**V} ~ [*V] ~ V.copy() ~ V.get('k')
 ~ V.pop()
 ~ V.setdefault('k', E) ~ next(iter(V)) ~ map(V.append, [E]) ~ (lambda: V) ~ (lambda x=V: x)()
 ~ sum([], E) ~ 1 ~ n ~ len(V)
 ~ f'{V}' ~ None ~ V.k ~ [x.append(1) for x in V] ~ (x.append(1) for x in V)
 ~ V() ~ V.append ~ getattr(V, 'append')
 ~ dict.get(V, 'k') ~ zip(V, E) ~ V is E ~ -V ~ V < E ~ 1 / n ~ V[:]
 ~ 20000 ~ list(V.values()) ~ {1} ~ V | E ~ V.data"""
STATEMENTS = """V = E ~ V = E ~ V = E ~ V.append(E) ~ V.append(E) ~ V += [E] ~ V[0] += [E] ~ V['k'] += [E] ~ V = V = E

 ~ V, V = E, E ~ V, V = E ~ [V, *V] = E ~ V[0] = E ~ V['k'] = E ~ V.k = E ~ V.extend(E) ~ V[0].append(E)
 ~ V *= 2
 ~ (V := E).append(1) ~ (E).append(E) ~ V.update(k=E) ~ list(V) ~ V, = E ~ E ~ f() ~ V = f() ~ del V
 ~ assert E ~ V: E = E
 ~ list(map(V.append, [E])) ~ sorted(V, key=lambda x: x.append(1)) ~ globals()['V'] = E
 ~ V = lambda x: x.append(E) ~ V(V)
 ~ V |= E ~ list.append(V, E) ~ setattr(V, 'k', E) ~ import copy
 ~ V = copy.copy(V) ~ C.k.append(1) ~ V[0][0] = E"""
BLOCKS = """for V in E: S ~ for V, V in [E]: S ~ if E: S ~ with E as V: S ~ match E:\n case V: S
 ~ match E:\n case [V, *_]: S
 ~ match E:\n case {'k': V}: S ~ try: S\nexcept Exception: S
 ~ try: raise ValueError(V)\nexcept ValueError as e: e.args[0].append(E)
 ~ def f(x=E): S ~ def f(): return E
 ~ class C(E): pass ~ class C: k = E ~ @E\ndef g(): pass ~ while n < 2:\n n += 1\n S
 ~ for x in V: x += [E]
 ~ await sleep(1)"""
VALUES, STATEMENTS, BLOCKS = (text.replace("\n ~", " ~").split(" ~ ") for text in (VALUES, STATEMENTS, BLOCKS))
MAPPINGS = ("<camunda:in variables='all'/><camunda:out variables='all'/>", "<camunda:in source='b' target='a'/>", "")


def _filled(random: Random, pattern: str, depth: int = 0) -> str:
    """A pattern with variables for V, expressions for E and statements for S."""
    words = {"V": lambda: random.choice("abc"), "S": lambda: _filled(random, random.choice(STATEMENTS), depth + 1),
             "E": lambda: _filled(random, random.choice(VALUES if depth < 3 else ["V"]), depth + 1)}  # fmt: skip
    alone = [not (pattern[at - 1 : at].isalnum() or pattern[at + 1 : at + 2].isalnum()) for at in range(len(pattern))]
    return "".join(words[one]() if one in words and free else one for one, free in zip(pattern, alone, strict=True))


def _model(scripts: list[str], guarded: set[int], called: int, mapping: str, condition: str) -> str:
    """The scripts one after another, some with an error event, one in a called process, and a condition at the end."""
    content, root = '<startEvent id="s"/><exclusiveGateway id="g" default="no"/><task id="a"/><task id="b"/>', ""
    ids = ["s", *(f"t{place}" for place in range(len(scripts))), "g"]
    flows = [*((*pair, "") for pair in pairwise(ids)), ("g", "a", escape(condition))]
    for place, script in enumerate(scripts):
        task = f'<scriptTask id="t{place}"><script>{escape(script)}</script></scriptTask>'
        if place == called:
            root = f'<process id="Q" isExecutable="true">{task.replace(f"t{place}", "q", 1)}</process>'
            task = f'<callActivity id="t{place}" calledElement="Q">{extensions(mapping)}</callActivity>'
        content += task
        if place in guarded:
            content += f'<boundaryEvent id="b{place}" attachedToRef="t{place}"><errorEventDefinition/></boundaryEvent>'
            flows.append((f"b{place}", ids[place + 2], ""))
    content += '<sequenceFlow id="no" sourceRef="g" targetRef="b"/>'
    for source, target, text in flows:
        inside = f"<conditionExpression>{text}</conditionExpression>" if text else ""
        ends = f'id="{source}-{target}" sourceRef="{source}" targetRef="{target}"'
        content += f"<sequenceFlow {ends}>{inside}</sequenceFlow>"
    return process(content, root)


@contextmanager
def little_memory(room: int = 1 << 31) -> Iterator[None]:
    """At most so many bytes more: of scripts that take all (a list that grows while it is read) nothing is said."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + room, hard))
    try:
        with suppress(MemoryError):
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def denied(seed: int) -> list[str]:
    """What a run of random scripts does that their exploration denies."""
    with little_memory():
        return _denied(seed)
    return []


def _denied(seed: int) -> list[str]:
    random = Random(f"scripts {seed}")
    scripts = [random.choice(("a = [1]\nb = [a]\nc = []\nn = 0", "a = []; b = {'k': a}\nc = [[1]]; n = 0"))]
    for _ in range(random.randrange(1, 5)):
        lines = (_filled(random, random.choice((*STATEMENTS, *BLOCKS))) for _ in range(random.randrange(1, 3)))
        scripts.append("\n".join(lines))
    guarded = {place for place in range(1, len(scripts)) if random.random() < 0.3}
    made = scripts, guarded, random.choice((0, 0, len(scripts) - 1)), random.choice(MAPPINGS)
    try:
        first = fame.Simulation(fame.read(_model(*made, "False").encode())).run(until=100).instances[0]
    except FameError:  # the text of a script is wrong
        return []
    name = random.choice("abc")
    value: Any = first.variables.get(name)
    text = repr(value) if "b" in first.visits and all(one not in repr(value) for one in "<...") else "0"
    definitions = fame.read(_model(*made, f"{name} == {text}").encode())
    entered = {*fame.Simulation(definitions).run(until=100).instances[0].visits}
    found = []
    for sentences in ([], [f"never P starts {one}" for one in sorted(entered) if one[0] in "abt"]):
        properties = [parse(one, NOWHERE, one) for one in sentences]
        result = explore(definitions, delivery="run", limit=300, samples=False, properties=properties)
        there = [place.element for one in result.findings if one.kind == "unreachable" for place in one.places]
        found += [one for one in there if one in entered]
        found += [one.name for one in result.properties if one.verdict in ("proved", "not triggered")]
    return [f"seed {seed}: {found} {made} {name} == {text}"] if found else []


if __name__ == "__main__":
    for seed in range(int(sys.argv[1]), int(sys.argv[2])):
        print(*denied(seed), sep="\n", end="", flush=True)
