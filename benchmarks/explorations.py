"""Whether two revisions explore and check alike: states, transitions, findings, their runs, verdicts, processor time.

    python benchmarks/explorations.py                       # this tree, its uncommitted changes included, beside main
    python benchmarks/explorations.py --against v0.2.0 --only cookbook --rounds 5

Explored are all models and scenarios that come with FAME (models, examples, cookbook, those of the tests) and 200
collaborations made at random, 100 of them with lists and mappings; of each also what `fame check` says. Both sides read
the models of this tree. A line for each case that differs, then the time of each kind of case (the best of all rounds,
which go by turns). Exit code 1 if a case differs.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
CODE = ("fame", "robots", "sim2d")
MODELS = ("models", "examples", "tests/models")
LIMIT = 5_000
"""States of a case: beyond, what was found so far is compared."""
RANDOM = 100
"""Collaborations of each of two kinds."""
Case = tuple[str, Callable[[], Any]]


def cases() -> Iterator[Case]:
    """Each case by its name, which begins with its kind, and what makes its model."""
    for folder in MODELS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix == ".bpmn" or (path.suffix == ".yaml" and "\nmodel:" in f"\n{path.read_text()}"):
                yield f"{path.relative_to(ROOT)}", lambda path=path: path  # type: ignore[misc]
    sys.path.insert(0, str(ROOT / "tests"))
    import collaborations

    for seed in range(RANDOM):
        yield f"random {seed}", lambda seed=seed: _varied(collaborations, seed)  # type: ignore[misc]
        yield (f"random with lists {seed}",
               lambda seed=seed: collaborations.team(collaborations.with_lists(seed)))  # type: ignore[misc]  # fmt: skip


def _varied(collaborations: Any, seed: int) -> Any:
    import fame

    robots, options = collaborations.varied(seed)
    return fame.read(collaborations.text_of(robots, **options).encode())


def outcome(model: Any) -> dict[str, Any]:
    """What an exploration and the checks say of a model; where it cannot be explored, why."""
    import fame
    from fame.check.checker import check
    from fame.scenario.explore.exploration import explore

    found: dict[str, Any] = {}
    if getattr(model, "suffix", ".bpmn") == ".bpmn":
        try:
            found["check"] = [str(one) for one in check(model, guidelines=True)]
        except fame.FameError as error:
            found["check"] = str(error)
    try:
        result = explore(model, limit=LIMIT, samples=False, delivery=("run", "fast"))
    except fame.FameError as error:
        return found | {"refused": str(error)}
    searches = [(one.delivery, one.states, one.transitions, one.cuts) for one in result.searches]
    whole = {name: getattr(result, name) for name in ("local", "outside", "steps", "widened", "status")}
    findings = [asdict(one) | {"level": one.level} for one in result.findings]
    return found | whole | {"searches": searches, "findings": findings, "properties": [*map(asdict, result.properties)]}


def explore_all(only: str) -> None:
    """Print a line of JSON for each case: its name, outcome and processor time, s."""
    for number, (name, make) in enumerate(one for one in cases() if only in one[0]):
        if not number:
            outcome(ROOT / "models" / "ground_vehicles.bpmn")  # everything is imported then
        begun = time.process_time()
        found = outcome(make())
        print(json.dumps([name, found, time.process_time() - begun], default=sorted), flush=True)


def run(folder: Path, only: str) -> tuple[dict[str, Any], dict[str, float]]:
    """Return each case's outcome and time with the code in a folder. Raises CalledProcessError."""
    script = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(ROOT / 'benchmarks')!r}]\n"
    script += f"import explorations; explorations.explore_all({only!r})"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True,
                          env={"PYTHONPATH": str(folder), "PATH": "", "PYTHONHASHSEED": "0"})  # fmt: skip
    lines = [json.loads(line) for line in done.stdout.replace(str(folder), str(ROOT)).splitlines()]
    return {name: found for name, found, _ in lines}, {name: seconds for name, _, seconds in lines}


def differences(former: Any, present: Any, place: str = "") -> Iterator[str]:
    """Where two outcomes differ, each with what it was and is."""
    if isinstance(former, dict) and isinstance(present, dict):
        for name in (*former, *(name for name in present if name not in former)):
            yield from differences(former.get(name), present.get(name), f"{place}.{name}")
    elif isinstance(former, list) and isinstance(present, list) and len(former) == len(present):
        for number, (one, other) in enumerate(zip(former, present, strict=True)):
            yield from differences(one, other, f"{place}[{number}]")
    elif former != present:
        yield f"{place.removeprefix('.')}: {former!r} -> {present!r}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--against", default="main", metavar="REVISION")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with this in their name")
    parser.add_argument("--rounds", type=int, default=1, help="of which the best times are taken")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        packed = subprocess.run(["git", "archive", arguments.against, *CODE], cwd=ROOT, capture_output=True, check=True)
        subprocess.run(["tar", "-x", "-C", one], input=packed.stdout, check=True)
        for name in CODE:
            shutil.copytree(ROOT / name, Path(other) / name)
        for folder in (one, other):
            shutil.copytree(ROOT / "models", Path(folder) / "models")
        then, now = dict[str, float](), dict[str, float]()
        for _ in range(arguments.rounds):
            former, times = run(Path(one), arguments.only)
            then = {name: min(seconds, then.get(name, seconds)) for name, seconds in times.items()}
            present, times = run(Path(other), arguments.only)
            now = {name: min(seconds, now.get(name, seconds)) for name, seconds in times.items()}
    differing = {name: found for name in former if (found := [*differences(former[name], present[name])])}
    for name, found in differing.items():
        print(f"{name}: {found[0]}" + (f" (and {len(found) - 1} more)" if len(found) > 1 else ""))
    for kind in ("models", "examples", "tests", "random "):
        before, after = (sum(s for name, s in times.items() if name.startswith(kind)) for times in (then, now))
        if before:
            print(f"{kind.strip():10}{before:8.2f} s ->{after:8.2f} s  {after / before - 1:+.1%}")
    states = sum(search[1] for one in present.values() for search in one.get("searches", ()))
    print(f"{len(present)} cases, {states} states: {len(differing)} differ")
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
