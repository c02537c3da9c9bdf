"""Writes the recording of a run in a second process, so that the run is slowed down little.

The run gives batches of calls of a `RunWriter` through a pipe: `marshal` (and `pickle`, for the functions that make the
messages of the simulated world) to the same Python, started by itself. A pipe that is full holds the run up. The second
process writes to the file that the run has opened and locked; it ends when the pipe does, also if the run was killed:
then everything that was sent is in the recording, and it is whole. Ctrl-C does not reach it.
"""

from __future__ import annotations

import gc
import json
import marshal
import os
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from io import BufferedWriter, FileIO
from subprocess import PIPE, Popen
from typing import TYPE_CHECKING, Any, BinaryIO

from fame.closing import Closing
from fame.errors import ConfigError, FameError
from fame.log.recording_file import FileWriter, RecordingFile, definition_of
from fame.robot.change_text import Changes, value_text

if TYPE_CHECKING:
    from fame.middleware.messages import Message

_BATCH = 64
"""Calls that are sent together, at most."""
_PIPE = 1 << 20
"""Bytes that wait in the pipe, where the system allows that."""
_START = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from fame.log.recorder_process import main; main()"


def is_useful() -> bool:
    """Whether a second process can write the file of this one, and has a processor of its own."""
    return sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1


class RecorderProcess(Closing):
    """A `RunWriter` that gives everything to a second process, which writes to an open `file`."""

    def __init__(self, file: FileIO, path: str, chunk: int) -> None:
        self._path = path
        command = [sys.executable, "-c", _START, json.dumps(sys.path), str(file.fileno()), str(chunk)]
        self._process = Popen(command, stdin=PIPE, stdout=PIPE, pass_fds=(file.fileno(),), process_group=0)
        assert self._process.stdin is not None
        self._pipe = self._process.stdin
        _enlarge(self._pipe.fileno())
        self._calls: list[tuple[Any, ...]] = []
        self._makers: dict[int, Callable[..., str]] = {}  # of the messages of the simulated world, by `id`
        self._channels = 0
        self._error: ConfigError | None = None  # why there is no process any more

    def describe(self, metadata: Mapping[str, str]) -> None:
        """Write the metadata of the recording."""
        self._calls.append(("describe", dict(metadata)))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """A file that belongs to it."""
        self._calls.append(("attach", name, media_type, bytes(data)))

    def robot(self, name: str, process: str) -> None:
        """A robot of the run, and the process (id) that it runs."""
        self._calls.append(("robot", name, process))

    def changes(self, robot: str, time: int, changes: Changes) -> None:
        """Record the changes of a robot up to a time (ns)."""
        self._calls.append(("changes", robot, time, changes))
        if len(self._calls) >= _BATCH:
            self._send()

    def key(self, time: int) -> None:
        """Everything as it is before the changes of this time (ns) is wanted."""
        self._calls.append(("key", time))

    def scene(self, topic: str, time: int, make: Callable[..., str], *data: Any) -> None:
        """A message of the simulated world at a time (ns): what `make`, which can be pickled, makes of plain data."""
        if id(make) not in self._makers:
            self._makers[id(make)] = make
            self._calls.append(("maker", id(make), pickle.dumps(make)))
        self._calls.append(("scene", topic, time, id(make), *data))

    def message_channel(self, topic: str, type: str, node: str) -> int:
        """The number of a new channel for messages of a ROS 2 type that `node` (full name) publishes."""
        self._calls.append(("message_channel", topic, type, node, definition_of(type)))
        self._channels += 1
        return self._channels - 1

    def message(self, channel: int, time: int, message: Message) -> None:
        """A message at a time (ns)."""
        from fame.middleware import codec

        self._calls.append(("write", channel, time, codec.serialize(message)))
        if len(self._calls) >= _BATCH:
            self._send()

    def finish(self) -> None:
        """There is nothing more: wait until all is written. Raises ConfigError if it cannot be."""
        self._calls.append(("finish",))
        self._send()
        self._end()

    def _send(self) -> None:
        if self._error is not None:
            raise self._error
        try:
            calls = marshal.dumps(self._calls)
        except ValueError:  # a detail of an event that is no plain data
            calls = marshal.dumps(_plain(self._calls))
        self._calls = []
        try:
            self._pipe.write(len(calls).to_bytes(8, "little") + calls)
            self._pipe.flush()
        except BrokenPipeError:
            self._end()

    def _end(self) -> None:
        """Wait for the end of the process. Raises ConfigError if it has not written everything."""
        with suppress(BrokenPipeError):
            self._pipe.close()
        assert self._process.stdout is not None
        with self._process.stdout as output:
            error = output.read().decode("utf-8", "replace").strip()
        code = self._process.wait()
        if code and not error:
            why = f"signal {-code}" if code < 0 else f"exit code {code}"
            error = f"is cut short: the process that writes it ended with {why}; run again to record all"
        if error:
            self._error = ConfigError(error, file=self._path)
            raise self._error

    def close(self) -> None:
        """End the process if it runs."""
        if self._process.returncode is None:
            with suppress(ConfigError):
                self._end()


def _enlarge(pipe: int) -> None:
    """Enlarge the buffer of a pipe, where the system allows that."""
    from fcntl import F_SETPIPE_SZ, fcntl

    with suppress(OSError):
        fcntl(pipe, F_SETPIPE_SZ, _PIPE)


def _plain(value: Any) -> Any:
    """A value without what `marshal` does not take: that becomes JSON, as bytes."""
    if isinstance(value, list | tuple):
        return tuple(map(_plain, value))
    if value.__class__ is dict:
        return {name: _plain(item) for name, item in value.items()}
    if value is None or value.__class__ in (int, float, bool, str, bytes):
        return value
    return value_text(value).encode("utf-8", "surrogatepass")


# ---- the second process ----------------------------------------------------------------------------------------------


def main() -> None:
    """Write what comes through standard input; an error is one line on standard output."""
    number, chunk = sys.argv[2:]
    gc.disable()  # nothing here refers to itself
    try:
        with FileIO(int(number), "ab", closefd=False) as file:
            write_calls(sys.stdin.buffer, file, int(chunk))
    except OSError as error:
        sys.exit(_print_error(f"cannot be written: {error.strerror}"))
    except FameError as error:
        sys.exit(_print_error(str(error)))
    os._exit(0)  # the run waits for the end: not for the tidying-up of the interpreter


def _print_error(text: str) -> int:
    sys.stdout.write(text)
    sys.stdout.flush()
    return 1


def write_calls(calls: BinaryIO, file: FileIO, chunk: int) -> None:
    """Write a recording from a stream of batches of calls; without a batch the file is left as it is."""
    writer: FileWriter | None = None
    makers: dict[int, Callable[..., str]] = {}
    finished = False
    with BufferedWriter(file, 1 << 16) as stream:
        for batch in _batches(calls):
            if writer is None:
                emptied(file)
                writer = FileWriter(RecordingFile(stream, chunk))
            for name, *arguments in batch:
                if name == "maker":
                    makers[arguments[0]] = pickle.loads(arguments[1])
                    continue
                if name == "scene":
                    arguments[2] = makers[arguments[2]]
                getattr(writer, name)(*arguments)
                finished = finished or name == "finish"
        if writer is not None and not finished:  # the run was killed
            writer.finish()


def _batches(calls: BinaryIO) -> Iterator[list[tuple[Any, ...]]]:
    """The batches of calls, as far as they are whole."""
    while len(head := calls.read(8)) == 8:
        batch = calls.read(size := int.from_bytes(head, "little"))
        if len(batch) != size:
            return
        yield marshal.loads(batch)


def emptied(file: FileIO) -> None:
    """Empty a file, if it is one and no device."""
    from stat import S_ISREG

    if S_ISREG(os.fstat(file.fileno()).st_mode):
        file.truncate(0)
        file.seek(0)  # what has an index counts from here
