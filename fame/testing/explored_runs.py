"""Runs that an exploration has found, on real engines: played, recorded, and written as tests.

Each step of a run (`fame.check.explore.trace.Step`) is a call of `fame.testing.by_hand.MissionByHand`. `play` makes
these calls; `test_of` writes them down.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

from fame.check.explore import Exploration, Finding
from fame.check.explore.trace import Step
from fame.dataclasses import dataclass
from fame.errors import ConfigError, ModelError
from fame.testing.by_hand import MissionByHand
from fame.testing.elements import Elements

WITHIN = 60.0
"""How long what is left of a mission may go on after a run (simulated s)."""
_METHODS = {
    "end": "finish", "fail": "finish", "timer": "fire", "person": "complete", "offer": "activate",
    "outside": "signal", "receive": "arrive", "miss": "arrive", "loss": "lose", "die": "fault", "block": "block",
}  # fmt: skip


_OUTCOMES = {"leave": "completed", "take": "completed", "fail": "failed", "cancel": "cancelled"}


@dataclass(frozen=True, slots=True)
class MethodCall:
    """A call of a method of `MissionByHand`. `comment`: the step, in the terms of the model."""

    method: str
    arguments: tuple[Any, ...]
    raises: str = ""
    comment: str = ""

    def make(self, mission: MissionByHand) -> None:
        more = {"raises": self.raises} if self.raises else {}
        getattr(mission, self.method)(*self.arguments, **more)

    def __str__(self) -> str:
        given = [repr(one).replace("'", '"') if "'" in repr(one) and '"' not in repr(one) else repr(one)
                 for one in self.arguments]  # fmt: skip
        given += [f'raises="{self.raises}"'] if self.raises else []
        return f"m.{self.method}({', '.join(given)})"


def calls(steps: Iterable[Step], elements: Elements) -> Iterator[MethodCall]:
    """Yield the calls for the steps of a run, decisions before the steps that take them."""
    for step in steps:
        for element, ways in _decisions(step).items():
            yield MethodCall(
                "decide", (step.robot, _name(elements, step.robot, element), *ways), comment="as in the run"
            )
        method = _METHODS.get(step.kind)
        if method == "fault":
            yield MethodCall(method, (step.robot, "engine"), comment=step.text)
        elif method is not None:
            what = _name(elements, step.robot, step.element) if step.element else step.detail
            raises = step.detail if step.kind == "fail" else ""
            yield MethodCall(method, (step.robot, what), raises, step.text)


def _decisions(step: Step) -> dict[str, list[bool | int]]:
    """Element -> what a step decides there."""
    found: dict[str, list[bool | int]] = defaultdict(list)
    for element, chosen, ways in step.choices:
        found[element].append(chosen == 0 if ways == 2 else chosen)
    return found


def _name(elements: Elements, robot: str, element: str) -> str:
    """An element as a person would name it: by its label, if no other one has it."""
    label = elements.label(robot, element)
    return label if label and elements.find(robot, label) == {element} else element


def play(mission: MissionByHand, steps: Iterable[Step]) -> MissionByHand:
    """Repeat a run on real engines."""
    for call in calls(steps, mission.elements):
        call.make(mission)
    mission.run  # noqa: B018 (begins, if there are no steps)
    return mission


# ---- tests -----------------------------------------------------------------------------------------------------------


_TEST = '''"""{title}

Found by `fame check --explore {model}` (delivery {delivery}).
This fails as long as the mission can get there. It passes once {mended}: on this way, or on another one
if a step of it has become impossible. Such steps are left out, and `fame test` names them.
"""


def {name}(mission):
    m = mission.by_hand({path}{robots}, lenient=True)
{steps}
{expected}
'''


def test_of(
    finding: Finding, elements: Elements, model: Path, folder: Path, robots: Mapping[str, int], refuted: str
) -> str:
    """Return a test for pytest, in a folder, that drives the run of a finding and expects that the robots complete, or
    that the property `refuted` holds."""
    expected = [f'    m.expect("{robot}").completed(within={WITHIN:g})' for robot in finding.robots]
    shown = [(str(call), call.comment) for call in calls(finding.run, elements)]
    width = max((len(line) for line, _ in shown), default=0)
    steps = [f"    {line:{width}}  # {comment}".rstrip(" #") if len(line) + len(comment) < 110
             else f"    # {comment}\n    {line}" for line, comment in shown]  # fmt: skip
    return _TEST.format(
        title="\n".join(wrap(_sentence(finding.text), 110)),
        model=model,
        delivery=finding.delivery,
        mended="the property holds" if refuted else "the mission completes",
        name=f"test_{refuted}_holds" if refuted else _function(finding),
        path=f'"{Path(os.path.relpath(model, folder)).as_posix()}"',
        robots=f", robots={dict(robots)!r}".replace("'", '"') if robots else "",
        steps="\n".join(steps),
        expected=f'    m.expect_property("{refuted}").holds()' if refuted else "\n".join(expected),
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _function(finding: Finding) -> str:
    """A name that says what is expected: the robots complete, and what nevertheless happens in the run."""
    last = next((step for step in reversed(finding.run) if step.kind not in ("receive", "start")), None)
    who = "_and_".join(map(_word, finding.robots)) if len(finding.robots) < 3 else "all"
    verb = "completes" if len(finding.robots) == 1 else "complete"
    after = _word(f"after {last.text.partition(',')[0]}".replace("'s ", " ")) if last is not None else ""
    return "_".join(part for part in ("test", who, verb, after) if part)[:90].rstrip("_")


def _word(robot: str) -> str:
    return re.sub(r"\W+", "_", robot).lower().strip("_")


# ---- files -----------------------------------------------------------------------------------------------------------


def write_runs(result: Exploration, scenario: Any, folder: Path, robots: Mapping[str, int], source: Path) -> list[Path]:
    """Write each run of an error, fault or refuted property: as a test, as a recording for `fame view`, as a picture.

    Gives the files. Raises ConfigError if the folder cannot be written to.
    """
    written: list[Path] = []
    counts: dict[str, int] = defaultdict(int)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for finding in result.findings:
            if finding.level == "error" or finding.kind == "fault":
                counts[finding.kind] += 1
                name = f"{source.stem}_{finding.kind}_{counts[finding.kind]}"
                written += _write(finding, scenario, folder, name, robots, source)
        for one in result.properties:
            if one.verdict == "refuted":
                finding = Finding("run", str(one), run=one.run, delivery=one.delivery)
                name = f"{source.stem}_property_{one.name}"
                written += _write(finding, scenario, folder, name, robots, source, one.name)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(folder)) from None
    return written


def _write(
    finding: Finding, scenario: Any, folder: Path, name: str, robots: Mapping[str, int], source: Path, refuted: str = ""
) -> Iterator[Path]:
    mission = MissionByHand(scenario, folder, lenient=True)
    try:
        test, recording = folder / f"test_{name}.py", folder / f"{name}.mcap"
        test.write_text(test_of(finding, mission.elements, source, folder, robots, refuted), encoding="utf-8")
        yield test
        recording.write_bytes(play(mission, finding.run).recorded())
        yield recording
        picture = _picture(finding, mission)
    finally:
        mission.close()
    if picture:
        drawn = folder / f"{name}.svg"
        drawn.write_text(picture, encoding="utf-8")
        yield drawn


def _picture(finding: Finding, mission: MissionByHand) -> str:
    """The diagram with what has completed and failed in the run, and the elements at which robots wait in the end."""
    from fame.bpmn.draw.diagram import draw

    visited: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for step in mission.trace.steps:
        if step.what in _OUTCOMES:
            visited[step.element][_OUTCOMES[step.what]] += 1
    for place in finding.places:
        visited[place.element]["waiting"] += 1
    notes = [finding.text, *_numbered(finding.run)]
    try:
        return draw(mission.scenario.definitions, visited, notes=notes)
    except ModelError:  # without a diagram
        return ""


def _numbered(steps: Sequence[Step]) -> list[str]:
    shown = [f"{number}. {step}" for number, step in enumerate(steps, 1)]
    return shown if len(shown) <= 30 else [*shown[:15], "...", *shown[-14:]]
