"""``fame log judge``, and what judges the properties of a team for other commands."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.output import print_json, table
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.bpmn.model import Definitions
    from fame.log.live_judge import LiveJudge
    from fame.properties import Judgement, Property, Vocabulary


def subject(
    path: Path, library: Sequence[Path] = ()
) -> tuple[tuple[Property, ...], Definitions | None, Vocabulary | None]:
    """Return the properties of a file; the model beside it, or the team of a scenario; `library`: further folders.

    A scenario has those beside and in its model, too. Raises ConfigError for a file that has none.
    """
    from fame.config.loader import read_document
    from fame.properties.files import KEYS, properties_and_model

    if read_document(path).mapping().keys() <= {*KEYS}:
        return (*properties_and_model(path), None)
    from fame.scenario import Scenario
    from fame.scenario.judging import team_vocabulary

    scenario = Scenario.load(path, library=library)
    if not scenario.properties:
        raise ConfigError("expected the key properties: {NAME: SENTENCE}", file=str(path))
    return scenario.properties, scenario.definitions, team_vocabulary(scenario)


def live_judge(arguments: Namespace, note: Callable[[str], object]) -> LiveJudge:
    """Return what judges the properties of ``--properties`` while a team runs; `note` gets violations."""
    from fame.log.live_judge import LiveJudge

    return LiveJudge(*subject(arguments.properties, arguments.library), note)


def judge(arguments: Namespace) -> int:
    """Judge logs, and print a table of each; exit code 1 on a violation, 3 if something is pending or not known."""
    from fame.log.bag_reader import is_bag
    from fame.log.bags import judge_bag
    from fame.log.judge import judge_log
    from fame.log.xes_reading import COLUMNS, is_xes
    from fame.properties.judgement import HEADS, exit_code

    columns = dict(arguments.columns)
    if wrong := columns.keys() - COLUMNS.keys():
        raise ConfigError(f"--columns: unknown key {min(wrong)!r}; keys are: {', '.join(COLUMNS)}")
    runs = _runs(arguments.runs)
    if columns and not any(map(is_xes, runs)):
        raise ConfigError(f"--columns is for .xes files, got {', '.join(map(str, runs))}")
    properties, model, team = subject(arguments.properties, arguments.library)
    judged: dict[str, list[Judgement]] = {
        str(path): judge_bag(path, properties, model, team)
        if is_bag(path)
        else judge_log(path, properties, model, team=team, columns=columns if is_xes(path) else {})
        for path in runs
    }
    if arguments.json:
        print_json({"runs": {path: [one.to_json() for one in each] for path, each in judged.items()}})
    else:
        rows = [(path, *one.row) for path, each in judged.items() for one in each]
        print(table(("run", *HEADS), rows) if len(judged) > 1 else table(HEADS, [row[1:] for row in rows]))
    return exit_code(one for each in judged.values() for one in each)


def _runs(paths: list[Path]) -> list[Path]:
    """The logs and bags, and those in folders. Raises ConfigError for a folder without one."""
    from fame.log.bag_reader import is_bag
    from fame.log.event_logs import EVENT_LOGS

    logs, files = (".mcap", *EVENT_LOGS), list[Path]()
    for path in paths:
        whole = not path.is_dir() or is_bag(path)
        inside = [path] if whole else sorted(
            inner for inner in path.rglob("*")
            if is_bag(inner) or (inner.name.lower().endswith(logs) and not is_bag(inner.parent))
        )  # fmt: skip
        if not inside:
            raise ConfigError(f"has no log ({', '.join(logs)}) and no bag", file=str(path))
        files += inside
    return files
