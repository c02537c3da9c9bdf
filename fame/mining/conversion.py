"""Converts recordings to other logs: JSON Lines, CSV, XES, OCEL 2.0, bags of ROS 2."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from shutil import rmtree
from types import MappingProxyType
from typing import Literal

from fame.bpmn.model import Definitions
from fame.clock import EPOCH, date_text
from fame.errors import ConfigError
from fame.iso8601 import parse_datetime
from fame.log.reading import PART
from fame.log.recording import Recording, models_of
from fame.log.writing import CONVERTED, OCEL, logging_to, replaced
from fame.mining.mission_level import MissionLevel
from fame.mining.ocel import CaseNumbers, ObjectVariables, write_ocel
from fame.robot.events import Event
from fame.robot.robot_state import COUNTED
from fame.text import suggestion


def convert(
    source: str | Path,
    target: str | Path,
    on_progress: Callable[[float], object] = lambda done: None,
    *,
    level: Literal["mission", "all"] | None = None,
    named: ObjectVariables = MappingProxyType({}),
    robots: Sequence[str] = (),
) -> list[str]:
    """Convert a recording to the format given by the suffix of the target, without one to a bag of ROS 2.

    Returns the warnings of the recording. `on_progress` takes how much is done, 0 to 1.
    `level`: everything, or what somebody drew (`fame.mining.mission_level`; for OCEL the default). `named`: for OCEL,
    objects that variables name. `robots`: patterns of names; the events of others are left out, in logs of events.
    Raises ConfigError for a name with another end, an option for another form, robots and variables that are not there,
    a file that is not a recording, and one that cannot be written.
    """
    target = Path(target)
    name = target.name.lower()
    if target.suffix and not name.endswith(CONVERTED):
        endings = ", ".join(CONVERTED)
        known = f"expected a file name that ends in one of {endings}, or the name of a folder for a bag of ROS 2"
        raise ConfigError(f"{known}, got {target.name!r}", file=str(target))
    bag, ocel = not target.suffix, name.endswith(OCEL)
    for given, option, fits, forms in (
        (level, "--level", not bag, "logs of events, not for bags"),
        (named, "--object", ocel, f"{OCEL} only"),
        (robots, "--robot", not bag and not ocel, "logs of single robots: .jsonl, .csv, .xes"),
    ):
        if given and not fits:
            raise ConfigError(f"{option} is for {forms}", file=str(target))
    with Recording(source) as recording:
        if bag:
            _write_bag(recording, target)
            return list(recording.warnings)
        models = models_of(recording)
        mission = MissionLevel(recording, models) if (level or ("mission" if ocel else "all")) == "mission" else None
        if ocel:
            with replaced(target) as part, part.open("wb") as stream:
                write_ocel(recording, models, mission, named, stream)
        else:
            _write_events(recording, models, target, _chosen(recording, robots), mission, on_progress)
        return list(recording.warnings)


def _chosen(recording: Recording, patterns: Sequence[str]) -> Sequence[str] | None:
    """The robots that patterns name; None: all. Raises ConfigError for a pattern that names none."""
    for pattern in patterns:
        if not any(fnmatchcase(robot, pattern) for robot in recording.robots):
            raise ConfigError(f"has no robot {pattern!r}: {suggestion(pattern, recording.robots)}", file=recording.file)
    named = [robot for robot in recording.robots if any(fnmatchcase(robot, pattern) for pattern in patterns)]
    return named if patterns else None


def _kept(recording: Recording, robots: Sequence[str] | None, mission: MissionLevel | None) -> str:
    """What a log has of its run, if it leaves something out; else nothing."""
    chosen = robots is not None or mission is not None
    parts = [f"level {'all' if mission is None else 'mission'}"] if chosen else []
    parts += [f"robots {', '.join(robots)}"] if robots else []
    parts += [recording.lack] if recording.lack else []
    return ", ".join(parts)


def _write_events(
    recording: Recording,
    models: Sequence[Definitions],
    target: Path,
    robots: Sequence[str] | None,
    mission: MissionLevel | None,
    on_progress: Callable[[float], object],
) -> None:
    """Write the log that the run would have written itself."""
    with replaced(target) as part, logging_to(part, models) as log:
        epoch = parse_datetime(recording.metadata.get("epoch", "1970-01-01T00:00:00Z"))
        if epoch != EPOCH:
            log(Event(0, "", 0, 0, "", "epoch", date_text(epoch)))
        if kept := _kept(recording, robots, mission):
            log(Event(0, "", 0, 0, "", PART, kept))
        cases = CaseNumbers()
        length, reported = max(1, recording.end - recording.start), 0.0
        for event in recording.events(robots=robots):
            if mission is None or event.element in mission.elements or event.what not in COUNTED:
                number = cases.number(event.robot, event.instance, event.what)
                log(event if number == event.instance else event._replace(instance=number))
            done = (event.time - recording.start) / length
            if done >= reported + 0.01:
                reported = done
                on_progress(done)
        for verdict in recording.verdicts:
            log(Event(recording.end, "", 0, 0, "", "verdict", verdict))
        if ended := recording.ended:
            log(ended)


def _write_bag(recording: Recording, target: Path) -> None:
    """Write the messages of the robots' topics, without FAME's own channels, as ``ros2 bag`` does."""
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    if target.exists():
        raise ConfigError("expected a new folder: it exists already", file=str(target))
    types = {name: topic.type for name, topic in recording.topics.items() if topic.encoding == "cdr"}
    if not types:
        raise ConfigError("has no messages of topics: record them (--log-topics all)", file=recording.file)
    try:
        with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            store = recording.typestore
            ends = {name: bag.add_connection(name, type, typestore=store(type)) for name, type in types.items()}
            for message in recording.messages(types):
                bag.write(ends[message.topic], message.time, message.data)
    except (OSError, WriterError) as error:
        rmtree(target, ignore_errors=True)
        raise ConfigError(f"cannot be written: {getattr(error, 'strerror', None) or error}", file=str(target)) from None
