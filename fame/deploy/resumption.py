"""Store an engine's mission with its deployment on disk, and resume it.

The directory holds the journal of the mission (`fame.robot.journal`) and a file with the envelope of its deployment,
which the header of the journal names by its hash. A new deployment writes both anew before its process starts. A robot
that is ready to start one keeps that as well: if its engine ends then, the next one is ready again. (It may have
promised several: what it held for when a newer one came, and that one.)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence, Set
from contextlib import suppress
from datetime import datetime, timedelta
from functools import partial, reduce
from hashlib import sha256
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Kind, Scheduler
from fame.dataclasses import dataclass
from fame.deploy import fields
from fame.deploy.envelope import Envelope, model_hash, stored_envelope
from fame.deploy.history import is_recalled
from fame.deploy.signing import verify_signature
from fame.errors import ConfigError, DeploymentError

if TYPE_CHECKING:
    from pathlib import Path

    from fame.deploy.loading import LoadedCandidate
    from fame.robot import RobotNode
    from fame.robot.durable import DurableRecorder
    from fame.robot.journal import SegmentContents, StateDirectory
    from fame.robot.options import RobotOptions
    from fame.robot.state_tables import Tables

_ENVELOPE, _PROMISE, _ASKS = "deployment-", "promise", b" asking"
_UNREADABLE = b"lost\n"
"""Stands for promises that could not be read, until something newer runs: a newer promise must not hide that."""


@dataclass(frozen=True, slots=True)
class StoredMission:
    """What was running: the deployment and the journal."""

    envelope: Envelope
    contents: SegmentContents


class StateKeeper:
    """The state of one engine in its directory.

    on_trouble  called with the reason when the disk cannot be written, and with an empty text when it can again
    """

    def __init__(
        self,
        directory: StateDirectory,
        robot: str,
        scheduler: Scheduler,
        on_trouble: Callable[[str], object],
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self.directory: StateDirectory = directory
        self.recorder: DurableRecorder | None = None
        self.answers: dict[str, Any] = {}  # to requests of people: see `fame.deploy.requests.TaskServer`
        self._unread: SegmentContents | None = None  # the journal of which, until that goes on
        self._kept: list[Envelope] = []  # whose promises are on the disk, oldest first
        self.asking = set[str]()  # deployments of these about which it asks the others: it takes no plain ``start``
        self._names: dict[str, str] = {}  # of the files of deployments, by their ids
        self._lost = ""  # why others that were there cannot be read
        self._robot, self._scheduler, self._on_trouble, self._wall_time = robot, scheduler, on_trouble, wall_time
        self._begun = self._clock()
        self._touch()

    # ---- reading -----------------------------------------------------------------------------------------------------

    def read(self, trusted: Sequence[Any]) -> StoredMission | None:
        """Return what was running, if something was.

        Raises ConfigError for a journal that is damaged, foreign, of another robot or not signed by a trusted key.
        """
        contents = self.directory.read()
        if contents is None:
            return None
        header, file = contents.header, str(contents.path)
        if header.get("robot") != self._robot:
            raise ConfigError(f"is the state of robot {header.get('robot')!r}, not of {self._robot!r}", file=file)
        self._unread = contents
        return StoredMission(self._envelope(header, trusted), contents)

    def _take_answers(self, tables: Tables) -> None:
        """Take the stored answers, and later refusals: what other answers reported is not in the stored state."""
        refused = {id: answer for id, answer in self.answers.items() if answer[0] == "refused"}
        self.answers.clear()
        self.answers.update({**tables.get("answers", {}), **refused})

    def before(self, runs: Envelope, trusted: Sequence[Any]) -> list[Envelope]:
        """Return what was started before that which `runs`, as far as it can be read and verified, oldest first."""
        found = {}
        with suppress(OSError):
            for path in self.directory.files(_ENVELOPE):
                with suppress(ConfigError, OSError):
                    envelope = _verified(self._read_file(path.name) or b"", path, trusted)
                    found[path.name] = envelope
        self._names = {envelope.deployment: name for name, envelope in found.items()}
        older = [one for one in found.values() if runs.phase == "run" or one.order < runs.order]
        return sorted((one for one in older if one.deployment != runs.deployment), key=lambda one: one.order)

    def _envelope(self, header: Mapping[str, Any], trusted: Sequence[Any]) -> Envelope:
        """The envelope that a journal names, verified. Raises ConfigError."""
        path = self.directory.path / str(header["envelope"])
        data = self._read_file(path.name)
        if data is None:
            raise ConfigError("is missing: it is the deployment that the journal names", file=str(path))
        if sha256(data).hexdigest() != header["envelope_hash"]:
            raise ConfigError("is damaged, or not the deployment that the journal names", file=str(path))
        return _verified(data, path, trusted)

    def promised(self, trusted: Sequence[Any]) -> tuple[list[Envelope], str]:
        """Return what the engine before was ready to start, verified, oldest first; and why not
        all of it can be read."""
        path = self.directory.path / _PROMISE
        damaged = ConfigError("is damaged", file=str(path))
        try:
            data = self._read_file(_PROMISE)
            lines = [] if data is None else data.split(b"\n")
            for key, text in zip_longest(lines[::2], lines[1::2]):
                if text is None or key.removesuffix(_ASKS) != _key(text):
                    self._lost = str(damaged)
                else:
                    self._kept.append(_verified(text, path, trusted))
                    self.asking |= {self._kept[-1].deployment} if key.endswith(_ASKS) else set()
        except ConfigError as error:
            self._lost = str(error)
        return list(self._kept), self._lost

    def _read_file(self, name: str) -> bytes | None:
        try:
            return self.directory.read_file(name)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=str(self.directory.path / name)) from None

    def away(self, stored: StoredMission, process: RobotNode) -> float:
        """Return how long the engine was away (s)."""
        if not process.scheduler.is_simulated:
            return max(0.0, self._wall_time() - self.directory.last_seen)
        from fame.robot.restoring import epoch_of, last_time

        return max(0.0, (epoch_of(process) + process.scheduler.now - last_time(stored.contents)) / SECOND)

    def _set_back(self, stored: StoredMission, process: RobotNode) -> int:
        """How far the clock is before the last moment of the engine before (ns)."""
        from fame.robot.restoring import epoch_of, last_time

        seen = 0 if process.scheduler.is_simulated else round(self.directory.last_seen * SECOND)
        return max(0, last_time(stored.contents), seen) - (epoch_of(process) + process.scheduler.now)

    def _clock(self) -> int:
        """The date of the scheduler's time 0, as the clock says now (ns since 1970)."""
        return round(self._wall_time() * SECOND) - self._scheduler.now

    def _epoch(self, mission: RobotNode | RobotOptions) -> int:
        """The same for dates that are stored: that of the mission, unless the clock was set since the engine began."""
        from fame.robot.restoring import epoch_of

        epoch, clock = epoch_of(mission), self._clock()
        return clock if abs(epoch - self._begun) < SECOND < abs(clock - epoch) else epoch

    def epoch_again(self, options: RobotOptions) -> datetime:
        """Return the date of the scheduler's time 0 for what this process itself resumes: that of what is stored."""
        from fame.robot.restoring import epoch_of

        later = self._epoch(options) - epoch_of(options)
        self._begun += later
        return options.epoch + timedelta(microseconds=later // 1000)

    # ---- writing -----------------------------------------------------------------------------------------------------

    def promise(self, candidate: LoadedCandidate) -> str:
        """Keep what the robot is ready to start: should it crash now, its team may start all the same.

        Returns why that is not possible, or nothing.
        """
        kept = [*self._kept, candidate.envelope]
        try:
            if candidate.envelope.migrate and self.recorder is not None:
                self.recorder.wait_until_written()  # else power loss leaves an older state, which may not fit the model
            self._write_promises(kept)
        except OSError as error:
            return f"its promise cannot be written to {self.directory.path}: {error.strerror}"
        self._kept = kept
        return ""

    def keep_asking(self, deployment: str) -> str:
        """Keep that the robot asks the others, for the next engine. Returns why not, or nothing."""
        if deployment not in self.asking:
            self.asking.add(deployment)
            try:
                self._write_promises(self._kept)
            except OSError as error:
                self.asking.remove(deployment)
                return f"asks nobody: that cannot be written to {self.directory.path}: {error.strerror}"
        return ""

    def drop_promise(self, deployment: str) -> None:
        """Drop the promise of a deployment that was called off; of what runs, it stays until the journal is on disk."""
        if any(one.deployment == deployment for one in self._kept):
            self._keep_only([one for one in self._kept if one.deployment != deployment])

    def forget_promises(self, order: tuple[int, str]) -> None:
        """Drop all promises up to the deployment of this `Envelope.order`: it runs, and that is on the disk."""
        if any(one.order <= order for one in self._kept):
            self._keep_only([one for one in self._kept if one.order > order])

    def _keep_only(self, envelopes: list[Envelope]) -> None:
        self._kept = envelopes
        self.asking &= {one.deployment for one in envelopes}
        with suppress(OSError):  # an engine that reads it again asks the others of its team
            self._write_promises(envelopes)

    def _write_promises(self, envelopes: list[Envelope]) -> None:
        if envelopes or self._lost:
            lines = [_UNREADABLE] * bool(self._lost)
            for text, envelope in zip(map(_text, envelopes), envelopes, strict=True):
                lines += [_key(text) + _ASKS * (envelope.deployment in self.asking), text]
            self.directory.write_file(_PROMISE, b"\n".join(lines))
        else:
            self.directory.remove_file(_PROMISE)

    def begin(
        self,
        envelope: Envelope,
        process: RobotNode,
        start: Callable[[], object],
        timers: dict[str, Any] | None,
        before: Sequence[Envelope] = (),
    ) -> None:
        """Record a process, and `start` it when its beginning is on the disk.

        timers  those that it takes over
        before  what was started earlier, and is kept
        """
        from fame.robot.durable import DurableRecorder
        from fame.robot.journal import Journal
        from fame.robot.restoring import description, goals_under_way
        from fame.robot.state_tables import fold

        self.stop()
        if (unread := self._unread) is not None:  # what ran before is replaced before it could go on
            self._unread = None
            with suppress(ConfigError):  # its directory may be gone
                tables: Tables = reduce(fold, unread.records(), {})
                self._take_answers(tables)
                process.runner.cancelled.take_up(goals_under_way(tables), process.runner.inbox.action)
        data = _text(envelope)
        key = sha256(data).hexdigest()
        name = f"{_ENVELOPE}{key[:16]}"
        header = {
            "robot": self._robot,
            "deployment": envelope.deployment,
            "hash": envelope.hash,
            **description(process.engine.program),
            "envelope": name,
            "envelope_hash": key,
        }
        journal = Journal(self.directory, header, partial(process.scheduler.worker, "fame journal"))
        self.recorder = DurableRecorder(
            process, journal, on_trouble=self._on_trouble, answers=self.answers, epoch=self._epoch(process)
        )
        self._names[envelope.deployment] = name
        kept = {name, *(self._names.get(one.deployment, "") for one in before)}
        clean = partial(self._remove_all_but, kept, envelope.order)
        self.recorder.begin_with(lambda: self.directory.write_file(name, data), clean, start, timers)
        self.recorder.anew = partial(self._write_anew, name, data)

    def _write_anew(self, name: str, data: bytes) -> None:
        """Write what belongs to the journal besides: the deployment, and what the robot is ready to start."""
        self.directory.write_file(name, data)
        self._write_promises(self._kept)

    def _remove_all_but(self, names: Set[str], order: tuple[int, str]) -> None:
        """Remove the other deployments, as soon as no journal names them, and their promises."""
        self._lost = ""
        self._keep_only([one for one in self._kept if one.order > order])
        for path in self.directory.files(_ENVELOPE):
            if path.name not in names:
                self.directory.remove_file(path.name)

    def resume(self, stored: StoredMission, process: RobotNode) -> Callable[[], object]:
        """Transfer the stored state to a loaded process. Returns a function that lets it go on.

        Raises ConfigError as `restored` does.
        """
        from fame.robot.durable import DurableRecorder
        from fame.robot.journal import Journal
        from fame.robot.restoring import description, restored

        tables = restored(process, stored.contents)
        try:
            worker = partial(process.scheduler.worker, "fame journal")
            journal = Journal.resume(self.directory, stored.contents, worker)
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror}", file=str(stored.contents.path)) from None
        journal.header = {**journal.header, **description(process.engine.program)}  # of the segments that follow
        self._take_answers(tables)
        self.recorder = recorder = DurableRecorder(process, journal, on_trouble=self._on_trouble, answers=self.answers)
        name = str(stored.contents.header["envelope"])
        recorder.anew = partial(self._write_anew, name, self._read_file(name) or b"")

        def go_on() -> None:
            self._unread = None
            recorder.go_on(tables, self.away(stored, process), self._set_back(stored, process))

        return go_on

    def stop(self) -> None:
        """Stop recording: what follows does not belong to the mission."""
        if self.recorder is not None:
            self.recorder.close()
            self.recorder.journal.close()
            self.recorder = None

    def drop(self) -> None:
        """As `stop`, but what is not on the disk yet is dropped; `read` and `promised` give what is there."""
        if self.recorder is not None:
            self.recorder.drop()
        self.stop()
        self.directory.last_seen = self._wall_time()
        self._kept, self.asking, self._lost = [], set(), ""

    def _touch(self) -> None:
        if self.recorder is not None:
            if self._unread is None:
                self.recorder.count_from(self._epoch(self.recorder.node))
            self.recorder.check_directory()
        else:
            with suppress(OSError):  # nothing runs that could be lost
                self.directory.touch()
        self._scheduler.after(SECOND, self._touch, Kind.TIMER)


def _text(envelope: Envelope) -> bytes:
    return envelope.to_json().encode()


def _key(text: bytes) -> bytes:
    return sha256(text).hexdigest().encode()


def _verified(data: bytes, path: Path, trusted: Sequence[Any]) -> Envelope:
    """The envelope in a file. Raises ConfigError, also if it is not signed by a trusted key where there are some."""
    try:
        envelope = stored_envelope(data.decode(errors="replace"))
        if trusted:
            verify_signature(fields.values(envelope), trusted)
            if model_hash(envelope.model.encode()) != envelope.hash or not is_recalled(envelope):
                raise DeploymentError("the hash of the model differs from the signed one")
    except DeploymentError as error:
        raise ConfigError(str(error), file=str(path)) from None
    return envelope
