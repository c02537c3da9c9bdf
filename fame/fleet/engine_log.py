"""The recordings that an engine writes itself: files in a folder, of bounded size, independent of the network.

They contain what the engine publishes for recorders and views. A file that has become large is finished, and the next
one begins with the current state; the oldest are deleted. `fame log merge` puts the files of a team together.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from fame.clock import SECOND, Entry, Scheduler, date_text
from fame.closing import Closing
from fame.errors import ConfigError
from fame.log.channels import KEY
from fame.log.live_team import LiveTeam
from fame.log.recording_file import RecordingFile
from fame.log.writing import RECORDING, new_file

FILES, SIZE = 10, 50_000_000
"""Number of files, and bytes of a file after which the next one begins."""
_FLUSH = 2 * SECOND


class EngineLog(Closing):
    """The recordings of one robot in a folder.

    At most `files` of about `size` bytes are kept. A write error is reported once to `note`; the mission continues.
    """

    def __init__(
        self,
        folder: Path,
        robot: str,
        scheduler: Scheduler,
        note: Callable[[str], object],
        *,
        files: int = FILES,
        size: int = SIZE,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._folder, self._robot, self._scheduler, self._note = folder, robot, scheduler, note
        self._files, self._size, self._wall_time = files, size, wall_time
        self._team = LiveTeam(None, None, scheduler, self._put)
        self._model: Mapping[str, Any] = {}
        self._stack = ExitStack()
        self._file: RecordingFile | None = None
        self._path = folder
        self._broken = False
        self._flushing: Entry = scheduler.after(_FLUSH, self._flush)

    def on_batch(self, batch: Mapping[str, Any]) -> None:
        """Take a batch of changes (`fame.robot.live`)."""
        self._team.feed(self._robot, batch)

    def on_model(self, model: Mapping[str, Any]) -> None:
        """Begin a new file for the process that the robot runs from now on, behind all that the one before has done."""
        self._team.pass_on()
        self._model = model
        self._finish()

    def _put(self, topic: str, time: int, data: Mapping[str, Any]) -> None:
        if self._broken:
            return
        try:
            if topic == KEY and self._file is not None and self._path.stat().st_size > self._size:
                self._finish()
            if self._file is None and topic == KEY:
                self._file = self._begin()
            if self._file is not None:
                self._file.put(topic, time, data)
        except (ConfigError, OSError) as error:
            self._give_up(error)

    def _begin(self) -> RecordingFile:
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(self._wall_time()))
        self._path, number = self._folder / f"{self._robot}-{stamp}{RECORDING}", 1
        while self._path.exists():
            number += 1
            self._path = self._folder / f"{self._robot}-{stamp}-{number}{RECORDING}"
        self._stack = ExitStack()
        file = RecordingFile(self._stack.enter_context(new_file(self._path))())
        epoch = {"epoch": date_text(self._team.epoch)} if self._team.epoch is not None else {}
        seed = {"seed": str(self._model["seed"])} if "seed" in self._model else {}
        file.describe({"robot": self._robot, **epoch, **seed})
        for model in self._model.get("models", ()):
            file.attach(f"models/{model['name']}", "application/bpmn+xml", str(model["xml"]).encode())
        self._delete_oldest()
        return file

    def _delete_oldest(self) -> None:
        """Delete the oldest files of this robot beyond the number to keep."""
        own = sorted(self._folder.glob(f"{self._robot}-*{RECORDING}"), key=lambda path: path.stat().st_mtime)
        for path in own[: -self._files]:
            path.unlink(missing_ok=True)

    def _flush(self) -> None:
        self._flushing = self._scheduler.after(_FLUSH, self._flush)
        if self._file is not None:
            try:
                self._file.flush()
            except (ConfigError, OSError) as error:
                self._give_up(error)

    def _finish(self) -> None:
        if self._file is not None:
            file, self._file = self._file, None
            try:
                file.finish()
                self._stack.close()
            except (ConfigError, OSError) as error:
                self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        self._broken, self._file = True, None
        self._note(f"the recording can no longer be written: {error}")

    def close(self) -> None:
        """Finish the file."""
        self._flushing.cancel()
        self._team.close()
        self._finish()
