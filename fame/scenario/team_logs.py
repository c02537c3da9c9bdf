"""The logs of a run in many processes: they are made from its recording."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from fame.clock import Scheduler
from fame.errors import ConfigError
from fame.log.recorder import About, LogTopics, model_attachments
from fame.log.recording_file import RecordingFile
from fame.log.team_recorder import TeamRecorder, TeamRecorderOptions
from fame.log.writing import CONVERTED, RECORDING, new_file
from fame.middleware.interface import Middleware
from fame.properties import Judgement
from fame.rooms import CONVERT_RECORDING, TOPICS_READ, load
from fame.text import wrong_ending

if TYPE_CHECKING:
    from fame.scenario.plan import Plan


class _Recording(RecordingFile):
    """A recording that is complete when it has been judged."""

    def finish(self) -> None:
        """Let it be read. It has no index yet."""
        self.flush()

    def complete(self, judgements: Sequence[Judgement]) -> None:
        """Write the judgements, and the index."""
        if judgements:
            self.describe({"properties": json.dumps([each.to_json() for each in judgements])})
        super().finish()


class TeamLogs:
    """The recording of a run, and the `logs` to be made from it."""

    def __init__(self, scenario: Plan, path: Path, logs: Sequence[Path], about: About, topics: LogTopics) -> None:
        self._scenario, self._path, self._logs, self._about, self._topics = scenario, path, logs, about, topics
        self._stack = ExitStack()
        self._begin = self._stack.enter_context(new_file(path))
        self._file: _Recording | None = None

    def recorder(self, middleware: Middleware, scheduler: Scheduler) -> TeamRecorder:
        """Return the node that records the team."""
        options = TeamRecorderOptions(
            robots=frozenset(self._scenario.cast),
            topics=self._topics,
            also=load(TOPICS_READ)(self._scenario) if self._scenario.properties else lambda info: False,
            metadata=self._about.metadata,
            models=False,
        )
        return TeamRecorder(middleware, scheduler, self._open, options)

    def _open(self) -> RecordingFile:
        file = self._file = _Recording(self._begin())
        for name, media_type, data in (*model_attachments(self._scenario.closures()), *self._about.attachments):
            file.attach(name, media_type, data)
        return file

    def finish(self, judge: Callable[[Path], Sequence[Judgement]]) -> Sequence[Judgement]:
        """Judge the recording, close it with what `judge` has found, and write the logs. Returns the judgements.

        If no robot sent an event there are no logs, and no property is known.
        """
        if self._file is None:
            self.close()
            text = "no robot sent an event"
            return [Judgement(one.name, one.sentence, "not known", text=text) for one in self._scenario.properties]
        found = judge(self._path)
        self.close(found)
        recording = self._path.resolve()
        for log in (log for log in self._logs if log.resolve() != recording):
            if log.suffix.lower() == RECORDING:
                copyfile(recording, log)
            else:
                load(CONVERT_RECORDING)(recording, log)
        return found

    def close(self, judgements: Sequence[Judgement] = ()) -> None:
        if self._file is not None:
            self._file.complete(judgements)
            self._file = None
        self._stack.close()


@contextmanager
def team_logs(scenario: Plan, logs: Sequence[Path], about: About, topics: LogTopics) -> Iterator[TeamLogs | None]:
    """Return the logs of a run in many processes; None without logs.

    Raises ConfigError for an unknown ending and a file that cannot be written, before anything is started.
    """
    if not logs:
        yield None
        return
    _check(logs)
    with TemporaryDirectory(prefix="fame-") as folder:
        path = next((log for log in logs if log.suffix.lower() == RECORDING), Path(folder) / "run.mcap")
        made = TeamLogs(scenario, path, logs, about, topics)
        try:
            yield made
        finally:
            made.close()


def _check(logs: Collection[Path]) -> None:
    known = (*CONVERTED, RECORDING)
    for log in logs:
        if not log.name.lower().endswith(known):
            raise ConfigError(wrong_ending(log.name, known), file=str(log))
        if log.suffix.lower() != RECORDING:
            load(CONVERT_RECORDING)
        with new_file(log):
            pass
