"""Compare explorations with runs of random collaborations. ``python -m tests.compare_explorations --models 500``

A model is explored, and run by real engines with several draws of what the exploration does not know: times, decisions,
failures. No run may come to what the exploration has not found (a deadlock, an uncaught error), nor enter what it calls
unreachable. Each run that it reports, played by real engines, has to end in the reported state. The full search has to
find the same as the reduced one. Properties made at random are proved or refuted by both alike, and no run violates one
that is proved. ``--draws 1000`` looks at the properties alone, with so many runs of each model: nothing that a run
violates is proved, and the run of each refutation, played by real engines, violates the property. ``--rich`` looks at
models with more of BPMN: at nothing but whether their runs show what their exploration denies.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parent))

from collaborations import text_of, varied

import fame
from fame.check.explore import Exploration, Finding
from fame.check.explore.canonical import stimuli
from fame.check.explore.findings import FAILING
from fame.check.explore.trace import Step
from fame.properties import Judge, Judgement, Property, Vocabulary, compile, parse, vocabulary_of
from fame.properties.sentence import NOWHERE
from fame.robot.events import Event
from fame.robot.node import RobotNode
from fame.scenario import Scenario
from fame.scenario.explore.exploration import cast_of, explore
from fame.scenario.run import Run
from fame.testing.by_hand import MissionByHand
from fame.testing.explored_runs import play

read = lru_cache(maxsize=8)(fame.read)  # a model once for all its explorations and runs
LIMIT = 2_000
"""States of a model; larger ones are not explored whole, and compared as far as they were."""
DRAWS = 5
"""Runs of each model."""
EVENTS = 20_000
"""Events of a run, after which it counts as endless: robots may answer each other for ever in no time."""


PATTERNS = ("never {}", "never {} before {}", "{} only after {}", "{} each time only after {}", "{}",
            "{} at most 2 times", "after {}, {}", "between {} and {}, {}", "after {}, {} only after {}",
            "between {} and {}, {} only after {}", "between {} and {}, {} each time only after {}")  # fmt: skip
"""Of properties made at random."""
CONDITIONS = ("always {v}.n < 2", "never {v}.n == {w}.n", "after {}, always {v}.n < 2", "never {v}.n == 1 until {}",
              "between {} and {}, always {v}.n <= {w}.n")  # fmt: skip
"""Of those about variables."""


class EndlessError(BaseException):
    """A run does not end. No Exception, so that no engine takes it for an error of its model."""


CALLED = ("Help_", "Move_", "Deep_")
"""Beginnings of ids in called processes."""


@dataclass(slots=True)
class Drawn:
    """What a run came to: where tokens are left, which elements were entered, and where errors were not caught."""

    waiting: frozenset[str] = frozenset()
    entered: set[tuple[str, str]] = field(default_factory=set)
    errors: set[str] = field(default_factory=set)
    judgements: tuple[Judgement, ...] = ()


def scenario_of(text: str, given: Sequence[Property] = ()) -> Scenario:
    """The same team as is explored."""
    definitions, library, cast = cast_of(read(text.encode()), {}, ())
    return Scenario(file=definitions.file, definitions=definitions, library=library, cast=cast, world=None, seed=0,
                    duration=300.0, properties=tuple(given))  # fmt: skip


def waiting(nodes: list[RobotNode]) -> frozenset[str]:
    """The elements at which tokens are."""
    running = (node.engine for node in nodes if node.engine.instances)
    return frozenset(element for engine in running for element, _ in stimuli(engine).waiting)


class LeftRun(Run):
    """A run that notes where tokens are left before it stops everything."""

    left: frozenset[str] = frozenset()
    over: bool = False

    def stop(self) -> None:
        self.over = True
        self.left = self.left or waiting(self.nodes)
        super().stop()


def run(text: str, judge: Judge | None = None, given: Sequence[Property] = ()) -> Drawn | None:
    """Run a team until nothing can move, before a judge of its properties; None if it goes on.

    Those `given` are judged by the run itself.
    """
    drawn, events = Drawn(), 0

    def observe(event: Event) -> None:
        nonlocal events
        events += 1
        if events > EVENTS:
            raise EndlessError
        if judge is not None and not made.over:
            judge.event(event.time, event.robot, event.element, event.what, event.detail)
        if event.what == "enter":
            drawn.entered.add((f"P_{event.robot.partition('_')[0]}", event.element))

    made = LeftRun(scenario_of(text, given), False, observe, None)
    try:
        result = made.result()
    except EndlessError:
        return None
    drawn.waiting, drawn.judgements = made.left, result.judgements
    drawn.errors = {error.element for robot in result.robots for error in robot.errors}
    return None if result.simulated >= 300 else drawn


def missed(result: Exploration, drawn: Drawn) -> Iterator[str]:
    """What a run shows and the exploration does not."""
    found = {kind: [{place.element for place in one.places} for one in result.findings if one.kind == kind]
             for kind in (*FAILING, "error")}  # fmt: skip
    for one in (
        one for one in result.findings if one.kind == "unreachable"
    ):  # of one pool, beside which others may call
        there = {element for process, element in drawn.entered if process in one.processes}
        there &= {place.element for place in one.places}
        if there:
            yield f"is called unreachable and entered: {sorted(there)}"
    if result.exhaustive:
        known = set().union(*found["error"])
        inside = any("_call_" in element for element in known)  # the exploration does not look into all behaviours
        if any(one not in known and not (inside and one.startswith(CALLED)) for one in drawn.errors):
            yield f"an error is not caught, and not found: {sorted(drawn.errors)}"
        stuck = [one for kind in FAILING for one in found[kind]]
        if drawn.waiting and not drawn.errors and not any(one <= drawn.waiting for one in stuck):
            yield f"a deadlock is not found: {sorted(drawn.waiting)}"


def verdicts(result: Exploration, *without: str) -> set[tuple[str, tuple[str, ...]]]:
    """What was found, without the way to it. Which signal was lost on the way to a deadlock depends on the way.

    A mission that never completes goes on between several states, of which any one may be reported.
    """
    kinds = {"lost": "deadlock"}
    checked = {"deadlock", "lost", "never", "dropped", "unreachable", "error"} - {*without}
    return {
        (kinds.get(one.kind, one.kind), tuple(sorted(place.element for place in one.places if one.kind != "never")))
        for one in result.findings
        if one.kind in checked
    }


def replayed(text: str, finding: Finding, folder: Path) -> Iterator[str]:
    """Why the run of a finding does not lead to what it says."""
    with closing(play(MissionByHand(scenario_of(text), folder, lenient=True), finding.run)) as mission:
        if mission.skipped:
            yield f"its run cannot be replayed: {finding.text}: {mission.skipped}"
        elif finding.kind in ("deadlock", "lost"):
            left, said = waiting(mission.run.nodes), {place.element for place in finding.places}
            if left != said:
                yield f"its run leads to {sorted(left)}: {finding.text}"
        elif finding.kind == "error":
            failed = {error.element for robot in mission.run.result().robots for error in robot.errors}
            if not failed & {place.element for place in finding.places}:
                yield f"its run leads to errors at {sorted(failed)}: {finding.text}"


def sentences(seed: int, names: Vocabulary, *, rich: bool = False) -> Iterator[str]:
    """Properties of a team, made at random."""
    random = Random(f"properties {seed}")

    def event() -> str:
        pool = random.choice(sorted({*names.pools, *(one for one in names.robots if "_" not in one)}))
        robot = random.choice(names.pools.get(pool, (pool,)))
        terms = names.robots[robot]
        said = [f"completes {one}" for one in terms.own] + [f"starts {one}" for one in terms.own]
        said += [f"throws {topic}" for topic in terms.throws if topic[0] == "/"] + ["completes", "ends"] * 3
        if rich:
            said += ["fails", "is cancelled"] * 3
            said += [f"fails at {one}{code}" for one in terms.own for code in ("", ' with "c"', ' with "no-go"')]
        return f"{random.choice((robot, pool))} {random.choice(said)}"

    for pattern in PATTERNS:
        yield pattern.format(*(event() for _ in range(pattern.count("{}"))))
    pools = sorted({*names.pools, *(one for one in names.robots if "_" not in one)})
    for pattern in CONDITIONS:
        yield pattern.format(event(), event(), v=random.choice(pools), w=random.choice(pools))


def played(text: str, made: Property, names: Vocabulary, run: Sequence[Step], folder: Path) -> str:
    """Why the run of a refutation does not violate the property, "" if it does."""
    judge = Judge([compile(made, names)])
    with closing(play(MissionByHand(scenario_of(text, (made,)), folder, lenient=True), run)) as mission:
        for event in mission.trace.steps:
            judge.event(event.time, event.robot, event.element, event.what, event.detail)
        judging = mission.run.judging if made.condition else None
        (found,) = judging.judgements() if judging is not None else judge.finish(10**15, complete=True)
        return "" if found.verdict == "violated" else f"{made.name} is refuted, its run: {found} {mission.skipped}"


def disproved(result: Exploration, drawn: Drawn, judge: Judge) -> Iterator[str]:
    """The proofs of properties that a run violates; `judge` has seen its events."""
    by_run = {one.name: one for one in drawn.judgements}
    for proof, judged in zip(result.properties, judge.finish(10**15, complete=True), strict=True):
        other = by_run.get(judged.name, judged)
        if other.verdict == "violated" and proof.verdict in ("proved", "not triggered"):
            yield f"{proof} is {proof.verdict}, and a run: {other}"


def denied(seed: int, draws: int = 3) -> tuple[bool, list[str]]:
    """Whether a rich model was explored whole, and what runs show that its exploration denies.

    Of every other model properties are judged, too: what they name is not reduced. What comes from outside has no runs.
    """
    robots, options = varied(seed, rich=True)
    definitions, library, cast = cast_of(read(text_of(robots, **options).encode()), {}, ())
    names = vocabulary_of(definitions, library, cast)
    given = [parse(one, NOWHERE, one) for one in sentences(seed, names, rich=True)] if seed % 2 else []
    result = explore(definitions, delivery="run", limit=LIMIT, samples=False, properties=given)
    found, valued = list[str](), [one for one in given if one.condition]
    for draw in range(0 if result.outside else draws):
        judge = Judge([compile(one, names) for one in given])
        drawn = run(text_of(robots, **options, drawn=Random(f"{seed} {draw}")), judge, valued)
        if drawn is not None:
            found += [f"draw {draw}: {one}" for one in (*missed(result, drawn), *disproved(result, drawn, judge))]
    return result.exhaustive, [f"seed {seed}: {one}" for one in found]


def judged_differently(seed: int, draws: int = DRAWS) -> tuple[int, list[str]]:
    """How many properties of a model the exploration knows, and where the full search or a run says otherwise."""
    robots, options = varied(seed)
    text = text_of(robots, **options)
    definitions, library, cast = cast_of(read(text.encode()), {}, ())
    names = vocabulary_of(definitions, library, cast)
    given = [parse(one, NOWHERE, one) for one in sentences(seed, names)]
    reduced, full = (
        explore(definitions, delivery="run", limit=LIMIT, samples=False, properties=given, reduced=one)
        for one in (True, False)
    )
    found = []
    if reduced.exhaustive and full.exhaustive:
        found += [f"{one}, and in the full search: {other}"
                  for one, other in zip(reduced.properties, full.properties, strict=True)
                  if one.verdict != other.verdict]  # fmt: skip
    for draw in range(draws if reduced.exhaustive else 0):
        judge = Judge([compile(one, names) for one in given])
        valued = [one for one in given if one.condition]
        drawn = run(text_of(robots, **options, drawn=Random(f"{seed} {draw}")), judge, valued)
        if drawn is not None:
            found += [f"draw {draw}: {one}" for one in disproved(reduced, drawn, judge)]
    refuted = [(one, made) for one, made in zip(reduced.properties, given, strict=True) if one.verdict == "refuted"]
    with tempfile.TemporaryDirectory() as folder:
        found += filter(None, (played(text, made, names, one.run, Path(folder)) for one, made in refuted))
    known = sum(one.verdict in ("proved", "refuted") for one in reduced.properties)
    return known, [f"seed {seed}: {one}" for one in found]


def compare(seed: int, folder: Path) -> tuple[bool, list[str]]:
    """Compare a model with its runs: whether it was explored whole, and all differences."""
    robots, options = varied(seed)
    text = text_of(robots, **options)
    result = explore(read(text.encode()), delivery="run", limit=LIMIT, samples=False)
    found = []
    for draw in range(DRAWS):
        drawn = run(text_of(robots, **options, drawn=Random(f"{seed} {draw}")))
        found += [f"draw {draw}: {one}" for one in missed(result, drawn)] if drawn is not None else []
    for finding in result.findings:
        if finding.kind in ("deadlock", "lost", "error"):
            found += replayed(text, finding, folder)
    full = explore(read(text.encode()), delivery="run", limit=LIMIT, samples=False, reduced=False)
    if full.exhaustive and verdicts(full) != verdicts(result):
        found.append(f"the reduced search finds {verdicts(result)}, the full one {verdicts(full)}")
    return result.exhaustive, [f"seed {seed}: {one}" for one in found]


def main() -> int:
    """Compare many models; exit code 1 if one differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--draws", type=int, default=0, metavar="N", help="the properties alone, with N runs of a model"
    )
    parser.add_argument("--rich", action="store_true", help="models with more of BPMN")
    arguments = parser.parse_args()
    seeds, whole, bad = range(arguments.first, arguments.first + arguments.models), 0, 0
    if arguments.draws or arguments.rich:
        look, draws = (denied if arguments.rich else judged_differently), arguments.draws or DRAWS
        with ProcessPoolExecutor(arguments.jobs) as pool:
            for known, found in pool.map(look, seeds, repeat(draws)):
                whole, bad = whole + known, bad + bool(found)
                print(*found, sep="\n", end="\n" if found else "", flush=True)
        what = "explored whole" if arguments.rich else "properties known"
        print(f"{arguments.models} models, {draws} runs each: {whole} {what}, {bad} models differ")
        return int(bad > 0)
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(arguments.jobs) as pool:
        compared = pool.map(compare, seeds, repeat(Path(folder)))
        judged = pool.map(judged_differently, seeds, repeat(2))
        for (exhaustive, found), (_, differing) in zip(compared, judged, strict=True):
            found += differing
            whole, bad = whole + exhaustive, bad + bool(found)
            print(*found, sep="\n", end="\n" if found else "", flush=True)
    print(f"{arguments.models} models, {whole} explored whole, {bad} differ")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
