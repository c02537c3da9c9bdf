"""Write what an exploration has found: for each run a test that fails today, and a picture of it on the diagram."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from fame.bpmn.model import Definitions
from fame.check.explore import Exploration, Finding
from fame.errors import ConfigError, ModelError

_TEST = '''"""{title}

Found by ``fame check --explore {model}`` (delivery {delivery}). The test fails as long as the mission can get there.
"""

from fame.scenario.replay import replay

MODEL = {path!r}
ROBOTS = {robots!r}
STEPS = [
{steps}
]
CHOICES = {choices!r}


def test_the_mission_completes_after_this_run():
    outcome = replay(MODEL, STEPS, robots=ROBOTS, choices=CHOICES)
    assert outcome.completed, f"still waiting: {{outcome.waiting}}"
'''


def write_traces(
    result: Exploration, definitions: Definitions, folder: Path, robots: Mapping[str, int], source: Path
) -> list[Path]:
    """Write a test and, if the model has a diagram, a picture for each failing finding; gives the files.

    Raises ConfigError if the folder cannot be written to.
    """
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for finding in (one for one in result.findings if one.level == "error" or one.kind == "fault"):
            name = f"{source.stem}_{finding.kind}_{1 + sum(finding.kind in path.stem for path in written) // 2}"
            test = folder / f"test_{name}.py"
            if finding.kind != "fault":
                test.write_text(_test(finding, robots, source), encoding="utf-8")
                written.append(test)
            picture = _picture(finding, definitions)
            if picture:
                drawn = folder / f"{name}.svg"
                drawn.write_text(picture, encoding="utf-8")
                written.append(drawn)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", file=str(folder)) from None
    return written


def _test(finding: Finding, robots: Mapping[str, int], source: Path) -> str:
    steps = "\n".join(
        f"    {(step.robot, step.kind, step.element, step.detail)!r},  # {step.text}" for step in finding.run
    )
    return _TEST.format(
        title=finding.text,
        model=source,
        path=str(source.resolve()),
        delivery=finding.delivery,
        robots=dict(robots),
        steps=steps,
        choices=finding.choices,
    )


def _picture(finding: Finding, definitions: Definitions) -> str:
    """The diagram with what has completed and failed in the run, and the elements at which robots wait in the end."""
    from fame.bpmn.draw.diagram import draw

    visited: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for step in finding.run:
        if step.element:
            visited[step.element]["failed" if step.kind == "fail" else "completed"] += 1
    for place in finding.places:
        visited[place.element]["waiting"] += 1
    notes = [finding.text, *_numbered(finding.run)]
    try:
        return draw(definitions, visited, notes=notes)
    except ModelError:  # without a diagram
        return ""


def _numbered(steps: Sequence[object]) -> list[str]:
    shown = [f"{number}. {step}" for number, step in enumerate(steps, 1)]
    return shown if len(shown) <= 30 else [*shown[:15], "...", *shown[-14:]]
