"""Options of commands that judge properties of a team, and their results."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Parser
from fame.rooms import LIVE_JUDGE, load

if TYPE_CHECKING:
    from fame.bpmn.model import Definitions
    from fame.log.team_recorder import RecordingJudge
    from fame.properties import Property, Vocabulary


def add_properties(parser: Parser) -> None:
    parser.add_argument(
        "--properties", type=Path, metavar="FILE.yaml",
        help="judge these properties (NAME.properties.yaml), or those of a scenario",
    )  # fmt: skip


def subject(path: Path) -> tuple[tuple[Property, ...], Definitions | None, Vocabulary | None]:
    """Return the properties of a file; the model beside it, or the team of a scenario.

    A scenario has those beside and in its model, too. Raises ConfigError for a file that has none.
    """
    from fame.config.loader import read_document
    from fame.errors import ConfigError
    from fame.properties.files import KEYS, properties_and_model

    if read_document(path).mapping().keys() <= {*KEYS}:
        return (*properties_and_model(path), None)
    from fame.scenario import Scenario
    from fame.scenario.judging import team_vocabulary

    scenario = Scenario.load(path)
    if not scenario.properties:
        raise ConfigError("expected the key properties: {NAME: SENTENCE}", file=str(path))
    return scenario.properties, scenario.definitions, team_vocabulary(scenario)


def live_judge(arguments: Namespace, note: Callable[[str], object]) -> RecordingJudge | None:
    """Return what judges the properties of ``--properties`` while a team runs; `note` gets violations."""
    if arguments.properties is None:
        return None
    judge: RecordingJudge = load(LIVE_JUDGE)(*subject(arguments.properties), note)
    return judge
