"""Merges recordings by time into one."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from datetime import datetime
from itertools import chain, combinations, count
from pathlib import Path

from fame.clock import date_text
from fame.errors import ConfigError
from fame.iso8601 import nanoseconds_between, parse_datetime
from fame.log.channels import EVENTS, KEY, VARIABLES, WAITING
from fame.log.recording import ModelRun, RecordedMessage, RecordedTopic, Recording
from fame.log.recording_file import RecordingFile
from fame.log.team_state import KeyWriter, TeamState, shift_times
from fame.log.writing import RECORDING, replaced
from fame.robot.events import ENDED
from fame.text import writable

OnProgress = Callable[[float], object]
"""Takes how much is done, 0 to 1."""


def merge(sources: Sequence[str | Path], target: str | Path, on_progress: OnProgress = lambda done: None) -> list[str]:
    """Merge recordings by time into one, and give what a person should know of them.

    Where several have the same robot or topic at the same time, that of fewer robots counts: an engine's own log before
    that of a recorder on the network. Raises ConfigError as `convert`.
    """
    if Path(target).suffix.lower() != RECORDING:
        raise ConfigError(f"expected a file name that ends in {RECORDING}, got {Path(target).name!r}", file=str(target))
    writable(Path(target), *sources)
    with ExitStack() as stack:
        recordings = [stack.enter_context(Recording(source)) for source in sources]
        merging = _Merging(recordings)
        part = stack.enter_context(replaced(Path(target)))
        file = RecordingFile(stack.enter_context(part.open("wb")))
        file.describe(
            {
                "epoch": date_text(merging.epoch),
                "merged": ", ".join(Path(one.file).name for one in recordings),
                **({"seeds": json.dumps(seeds)} if (seeds := _seeds(recordings)) else {}),
                **merging.proof(),
            }
        )
        for name, data in merging.attachments.items():
            file.attach(name, "application/bpmn+xml" if name.endswith(".bpmn") else "application/octet-stream", data)
        merging.write(file, on_progress)
        if merging.runs:
            file.describe({"models": json.dumps(merging.runs)})
        file.finish()
        return [warning for one in recordings for warning in one.warnings]


def _seeds(recordings: Iterable[Recording]) -> dict[str, int]:
    """The seeds of the random numbers of each robot, as far as recordings have them."""
    found: dict[str, int] = {}
    for metadata in (recording.metadata for recording in recordings):
        found |= json.loads(metadata.get("seeds", "{}"))
        if "robot" in metadata and "seed" in metadata:
            found[metadata["robot"]] = int(metadata["seed"])
    return found


class _Merging:
    """Recordings that are being merged.

    epoch        the earliest of theirs
    attachments  all files in them; one that differs from an earlier one of that name is named after its recording
    runs         what each robot ran (`Recording.runs`), complete when all is written
    """

    def __init__(self, recordings: Sequence[Recording]) -> None:
        epochs = [parse_datetime(one.metadata.get("epoch", "1970-01-01T00:00:00Z")) for one in recordings]
        self.epoch: datetime = min(epochs)
        self._recordings = recordings
        self._shifts = [nanoseconds_between(self.epoch, each) for each in epochs]
        self._spans = [self._spans_of(one, shift) for one, shift in zip(recordings, self._shifts, strict=True)]
        self._expect_runs_apart()
        self._expect_one_type()
        self._channels: dict[tuple[str, str], int] = {}
        self.attachments: dict[str, bytes] = {}
        self._names = [self._attach(one) for one in recordings]
        self.runs: dict[str, list[ModelRun]] = {}
        for number, recording in enumerate(recordings):
            for robot, runs in recording.runs.items():
                for time, process, models in runs:
                    self._note_run(robot, ModelRun(time + self._shifts[number], process, self._renamed(number, models)))

    def _expect_runs_apart(self) -> None:
        """Refuse runs of one robot at one time: other recordings of one time are of the same mission."""
        runs = [each for each in zip(self._recordings, self._spans, strict=True) if _is_run(each[0])]
        for (one, spans), (other, others) in combinations(runs, 2):
            for subject, (first, last) in spans.items():
                if subject in others and others[subject][0] <= last and first <= others[subject][1]:
                    text = f"is another run at the same time as {one.file}: both have {subject}; give each its --epoch"
                    raise ConfigError(text, file=str(other.file))

    def _expect_one_type(self) -> None:
        """Refuse recordings with a topic of two types: whoever reads one expects one."""
        known: dict[str, tuple[RecordedTopic, Recording]] = {}
        for recording in self._recordings:
            for name, topic in recording.topics.items():
                other, before = known.setdefault(name, (topic, recording))
                types = [
                    (each.type, one.definitions.get(each.type)) for each, one in ((topic, recording), (other, before))
                ]
                if topic.encoding == "cdr" and types[0] != types[1]:
                    kind = other.type if other.type != topic.type else "one with other fields"
                    raise ConfigError(f"{name} is {topic.type}, and in {before.file} {kind}", file=recording.file)

    def proof(self) -> dict[str, str]:
        """Return what a judge has to know of the recordings (`fame.log.judge`): how their runs ended, whether clocks
        may be apart, as those of engines with logs of their own, and which are incomplete."""
        known, ends = dict[str, str](), [one.metadata.get(ENDED) for one in self._recordings]
        if "cut" in ends or None not in ends:
            known[ENDED] = "cut" if "cut" in ends else "complete"
        own = len({robot for one in self._recordings for robot in one.robots}) > 1
        if any("clocks" in one.metadata or (own and "robot" in one.metadata) for one in self._recordings):
            known["clocks"] = "measured"
        if torn := [Path(one.file).name for one in self._recordings if one.warnings]:
            known["incomplete"] = ", ".join(torn)
        ended = (one.end + shift for one, shift in zip(self._recordings, self._shifts, strict=True))
        return {**known, "end": str(max(ended))}

    def _attach(self, recording: Recording) -> dict[str, str]:
        """Take the files of a recording. Returns their new names."""
        names: dict[str, str] = {}
        for name, data in recording.attachments.items():
            folder, stem, last = Path(name).parent, Path(recording.file).stem, Path(name).name
            others = (f"{folder}/{stem}-{number}-{last}" for number in count(2))
            candidates = chain((name, f"{folder}/{stem}-{last}"), others)
            names[name] = next(each for each in candidates if self.attachments.setdefault(each, data) == data)
        return names

    def _renamed(self, number: int, models: Iterable[str]) -> list[str]:
        """The names of models of a recording among `attachments`."""
        names = self._names[number]
        return [names[path].removeprefix("models/") for name in models if (path := f"models/{name}") in names]

    def _note_run(self, robot: str, run: ModelRun) -> None:
        runs = self.runs.setdefault(robot, [])
        if not runs or runs[-1][1:] != run[1:]:
            runs.append(run)
            runs.sort()

    def _spans_of(self, recording: Recording, shift: int) -> dict[str, tuple[int, int]]:
        """First and last time of each robot and topic in it."""
        spans: dict[str, tuple[int, int]] = {}
        for message in recording.messages():
            subject, time = _subject(message), message.time + shift
            if message.topic != KEY:
                spans[subject] = spans.get(subject, (time, time))[0], time
        return spans

    def write(self, file: RecordingFile, on_progress: OnProgress) -> None:
        """Write all messages, by time."""
        writer = KeyWriter(file.put)
        sources = [self._source(number) for number in range(len(self._recordings))]
        total = sum(topic.count for one in self._recordings for topic in one.topics.values()) or 1
        for done, (time, number, message) in enumerate(heapq.merge(*sources, key=lambda item: item[0])):
            if done % 1000 == 0:
                on_progress(done / total)
            if message.topic == KEY:
                self._take_key(writer, time, number, message)
            elif self._counts(number, _subject(message), time):
                time = max(time, writer.last)
                if message.topic in (EVENTS, VARIABLES, WAITING):
                    data = shift_times(message.topic, message.json(), self._shifts[number])
                    writer.change(time, message.topic, data)
                elif message.topic.startswith("/fame/"):
                    file.put(message.topic, time, message.json())
                else:
                    self._write(file, time, number, message)
                writer.last = time

    def _source(self, number: int) -> Iterator[tuple[int, int, RecordedMessage]]:
        for message in self._recordings[number].messages():
            yield message.time + self._shifts[number], number, message

    def _counts(self, number: int, subject: str, time: int) -> bool:
        """Whether no recording that comes first has this robot or topic at this time."""
        rank = len(self._recordings[number].robots), number
        for other, spans in enumerate(self._spans):
            span = spans.get(subject)
            before = (len(self._recordings[other].robots), other) < rank
            if before and span is not None and span[0] <= time <= span[1]:
                return False
        return True

    def _take_key(self, writer: KeyWriter, time: int, number: int, message: RecordedMessage) -> None:
        """Add the state of robots that this recording contains from now on, also after a gap."""
        data = shift_times(KEY, message.json(), self._shifts[number])
        state, known = TeamState.from_key(time, data), writer.state.robots
        fresh = [
            robot
            for robot, its in state.robots.items()
            if known.get(robot) != its and self._counts(number, robot, time)
        ]
        if fresh:
            known.update((robot, state.robots[robot]) for robot in fresh)
            lost, time = data.get("gaps", {}), max(time, writer.last + 1)
            recording = self._recordings[number]
            if "robot" in recording.metadata:  # an engine's own log has the models that it ran, and nothing else
                for robot in fresh:
                    models = self._renamed(number, recording.models)
                    self._note_run(robot, ModelRun(time - 1, state.robots[robot].process, models))
            writer.key(time, {robot: lost.get(robot, 0) for robot in fresh})

    def _write(self, file: RecordingFile, time: int, number: int, message: RecordedMessage) -> None:
        place = message.topic, message.node
        if place not in self._channels:
            self._channels[place] = file.same_channel(*self._recordings[number].channel(*place))
        file.write(self._channels[place], time, message.data)


def _is_run(recording: Recording) -> bool:
    """Whether it is the log of a whole run; an engine's own, and that of a recorder, may have what another one has."""
    return "seed" in recording.metadata and "robot" not in recording.metadata


def _subject(message: RecordedMessage) -> str:
    """The robot or topic that a message is about: each comes from one recording at a time."""
    return str(message.json()["robot"]) if message.topic in (EVENTS, VARIABLES, WAITING) else message.topic
