"""What properties cost: a step of a monitor, a run of the farm with twenty of them, and states of explorations.

    python benchmarks/properties.py [--runs 3]
    python benchmarks/properties.py --reaction dds [--runs 3]

Times are CPU seconds of this process, the least of several runs, so that other load counts little. With --reaction: how
long after its bound a robot reacts to another one that is stopped, by the clocks of their recording.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from fame.properties import Judge, Monitor, compile, parse, vocabulary_of
from fame.properties.parts import OPENS, OTHER
from fame.scenario import Scenario
from fame.scenario.explore.exploration import cast_of, explore
from fame.scenario.judging import team_vocabulary

ROOT = Path(__file__).parent.parent
STEPS = 100_000
MISSIONS = ("ground_vehicles", "agriculture", "agriculture_resilient", "convoy", "delivery", "shuttle", "reassembly",
            "sabotage")  # fmt: skip
SENTENCES = (
    'after Drone throws /weed_found, some Tractor starts "Go To" within 12 s',
    'after Drone throws /weed_found, some Tractor completes "Cut Grass" within 120 s',
    "always distance(any two Tractor) > 0.5",
    "always Drone.battery > 0.1",
    'Tractor starts "Cut Grass" each time only after Tractor completes "Go To"',
    'never Drone starts "Return to Base" before Drone completes "Explore"',
    "Drone completes within 300 s",
    "Drone throws /weed_found at most 9 times",
    'between Drone starts "Explore" and Drone starts "Land", always Drone.battery > 0.1',
    "never Tractor fails",
)


def least(runs: int, action: Callable[[], object]) -> float:
    """CPU s of the fastest of several runs."""
    times = []
    for _ in range(runs):
        begun = time.process_time()
        action()
        times.append(time.process_time() - begun)
    return min(times)


def step_cost(monitor: Monitor, runs: int) -> None:
    """Print what a step costs, in events that ask and answer by turns: of a part alone, and with its judge."""
    turns = sorted(((found[0].roles & (OPENS | OTHER) == 0, key) for key, found in monitor.events.items()))
    asks, answers = (next(key for late, key in turns if late is wanted) for wanted in (False, True))
    roles = [monitor.events[key][0].roles for key in (asks, answers)]
    number = monitor.events[answers][0].part

    def step() -> None:
        part, state = monitor.parts[number], monitor.initial[number]
        for at in range(STEPS):
            state = part.step(state, at, roles[at & 1])
        assert part.verdict(state).word in ("holds", "pending")

    def judged() -> None:
        judge = Judge([monitor])
        for at in range(STEPS):
            judge.event(at, *(answers if at & 1 else asks))

    shown = monitor.spec.sentence
    print(
        f"{shown}: a step {least(runs, step) / STEPS * 1e6:.2f} us, judged {least(runs, judged) / STEPS * 1e6:.2f} us"
    )


def states(name: str) -> float:
    """Print how many states a mission has without and with three properties of a pool; gives their ratio."""
    model = ROOT / "examples" / f"{name}.yaml"
    definitions, library, cast = cast_of(model, {}, ())
    names = vocabulary_of(definitions, library, cast)
    robot, first, second = next(
        (robot, *own[:2]) for robot in cast
        if len(own := [one for one in names.robots[robot].own if one.startswith("Activity")]) > 1
    )  # fmt: skip
    who = cast[robot].name if cast[robot].name in names.pools else robot
    given = [
        parse(text.format(who=who, first=first, second=second), name=text)
        for text in (
            "{who} starts {second} each time only after {who} completes {first}",
            "never {who} starts {second} before {who} completes {first}",
            "{who} completes {first} at most 3 times",
        )
    ]
    few, many = (explore(model, delivery="run", properties=one).states for one in ([], given))
    print(f"{name}: {few:,} states, with 3 properties {many:,}")
    return many / few


def reactions(middleware: str, runs: int) -> list[str]:
    """How late a robot reacts, in each of several runs (s)."""
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    from test_watch_property import DOMAIN, reaction

    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    found = []
    for _ in range(runs):
        with TemporaryDirectory() as folder:
            found.append(f"{reaction(middleware, Path(folder))[1]:.3f}")
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--reaction", choices=("dds", "zenoh"))
    runs, middleware = (given := parser.parse_args()).runs, given.reaction
    if middleware:
        print(f"{middleware}: reacted {', '.join(reactions(middleware, runs))} s after the bound")
        return
    scenario = Scenario.load(ROOT / "examples" / "agriculture.yaml")
    vocabulary = team_vocabulary(scenario)
    for sentence in (SENTENCES[0], SENTENCES[4]):
        step_cost(compile(parse(sentence), vocabulary), runs)
    properties = tuple(parse(text, name=f"p{at}") for at, text in enumerate(SENTENCES * 2))
    plain, twenty = replace(scenario, properties=()), replace(scenario, properties=properties)
    ignore = lambda event: None  # noqa: E731  (as the progress of fame run: the engines are observed)
    pairs = [(least(1, lambda: plain.run(observer=ignore)), least(1, lambda: twenty.run(observer=ignore)))
             for _ in range(runs)]  # fmt: skip
    without, judged_run = (min(times) for times in zip(*pairs, strict=True))
    print(f"agriculture: {without:.2f} s, with 20 properties {judged_run:.2f} s: {judged_run / without - 1:+.1%}")
    print(f"states: {median(map(states, MISSIONS)):.2f} times as many (median)")


if __name__ == "__main__":
    main()
