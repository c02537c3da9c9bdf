"""The file under a robot's journal: torn ends, damage, foreign files, the lock, growth, a full disk."""

import errno
import os
import sqlite3
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import orjson
import pytest
from durable_runs import ends as ends_of

from fame.errors import ConfigError
from fame.robot import journal as module
from fame.robot.journal import Journal, JournalRecord, StateDirectory, read_segment
from fame.robot.state_tables import fold
from fame.worker import Done, Worker, outcome


@pytest.fixture
def directory(tmp_path: Path) -> Iterator[StateDirectory]:
    made = StateDirectory(tmp_path / "state")
    yield made
    made.close()


def written(directory: StateDirectory, records: int = 5, synced: int = 0) -> Path:
    """A segment with a state and some changes, of which the first `synced` were on the disk before the rest came."""
    journal = Journal(directory, {"robot": "R"})
    journal.begin_segment({"state": 0})
    for number in range(records):
        journal.append({"number": number, "text": "ü" * number})
        if number + 1 == synced:
            journal.sync(lambda: None)
    journal.close()
    return directory.segments()[-1]


def changes(path: Path) -> list[JournalRecord]:
    """The changes in a segment."""
    return list(read_segment(path).records())[1:]


def test_what_was_written_is_read_again(directory: StateDirectory) -> None:
    found = read_segment(written(directory))
    state, *changes = found.records()
    assert (state, found.header["robot"]) == ({"state": 0}, "R")
    assert [change["number"] for change in changes] == [0, 1, 2, 3, 4]
    assert found.last_record() == changes[-1]


def test_values_that_the_fast_encoder_does_not_know_are_written_all_the_same(directory: StateDirectory) -> None:
    class Metres(float):
        pass

    record = {
        "big": 2**70,
        "surrogate": "\ud800",
        "numpy": np.float64(0.1),
        "metres": Metres(2.5),
        "sent": orjson.Fragment(b'[{"data":1.5}]'),
    }
    journal = Journal(directory, {})
    journal.begin_segment({})
    journal.append({"numpy": np.float64(0.1), "sent": record["sent"]})
    journal.append(record)
    journal.close()
    found = directory.read()
    assert found is not None
    _, first, second = found.records()
    assert first == {"numpy": 0.1, "sent": [{"data": 1.5}]}
    assert second == {"big": 2**70, "surrogate": "\ud800", "numpy": 0.1, "metres": 2.5, "sent": [{"data": 1.5}]}


def test_a_file_cut_at_any_byte_ends_with_the_last_whole_record(directory: StateDirectory) -> None:
    path = written(directory)
    data, ends = path.read_bytes(), ends_of(path)
    for length in range(ends[0], len(data)):
        path.write_bytes(data[:length])
        found = read_segment(path)
        assert found.number == len(list(found.records())) == sum(end <= length for end in ends)
        assert found.end == max(end for end in ends if end <= length)


def test_a_byte_that_is_wrong_in_the_last_two_records_ends_the_journal_there(directory: StateDirectory) -> None:
    path = written(directory)
    data, ends = path.read_bytes(), ends_of(path)
    for place in range(ends[-3], len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        assert read_segment(path).number == (4 if place < ends[-2] else 5)


def test_after_a_torn_end_it_goes_on_behind_the_last_whole_record(directory: StateDirectory) -> None:
    path = written(directory)
    path.write_bytes(path.read_bytes()[:-3])
    journal = Journal.resume(directory, read_segment(path))
    journal.append({"number": "again"})
    journal.close()
    assert [change["number"] for change in changes(path)] == [0, 1, 2, 3, "again"]


def test_a_record_that_was_on_the_disk_and_is_wrong_is_damage(directory: StateDirectory) -> None:
    path = written(directory, synced=3)
    data, ends = path.read_bytes(), ends_of(path)
    place = ends[1] + 20
    path.write_bytes(data[:place] + b"?" + data[place + 1 :])
    with pytest.raises(ConfigError, match=rf"is damaged at byte {ends[1]}: record 3 was on the disk"):
        read_segment(path)


def test_a_segment_without_its_state_is_damaged(directory: StateDirectory) -> None:
    path = written(directory, 0)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ConfigError, match="the state at its beginning is missing"):
        read_segment(path)


@pytest.mark.parametrize("content", [b"", b"\n", b"hello\n", b"\x00" * 100, b'{"fame": 1}\n', b"00000000 0 0 {}\n"])
def test_a_foreign_file_is_refused(directory: StateDirectory, content: bytes) -> None:
    path = written(directory)
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="is not a journal of a FAME engine"):
        directory.read()


def test_another_format_is_refused(directory: StateDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FORMAT", 99)
    path = written(directory)
    monkeypatch.undo()
    with pytest.raises(ConfigError, match="has format 99; this version of FAME reads format 1"):
        read_segment(path)


def test_lines_of_another_journal_are_not_taken_for_its_own(directory: StateDirectory) -> None:
    path = written(directory, 1)
    other = written(directory, 3)
    path = directory.segments()[-1]
    data, ends = path.read_bytes(), ends_of(path)
    foreign = written(directory, 3)
    lines = foreign.read_bytes().splitlines(keepends=True)
    foreign.write_bytes(data[: ends[1]] + lines[3])
    assert len(changes(foreign)) == 1
    assert not other.exists()


def test_a_directory_serves_one_engine_at_a_time(directory: StateDirectory) -> None:
    text = f"from fame.robot.journal import StateDirectory; StateDirectory({str(directory.path)!r})"
    found = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert f"{directory.path}: is in use by another engine (process {os.getpid()})" in found.stderr


def test_of_a_directory_that_was_replaced_no_lock_stays_open(directory: StateDirectory) -> None:
    def opened() -> int:
        return len(os.listdir("/proc/self/fd"))

    before = opened()
    directory.path.rename(directory.path.with_name("other"))
    directory.path.mkdir()
    assert directory.lock_again()
    assert (directory.lock_again(), opened()) == (False, before)


def test_it_is_for_its_owner_alone(directory: StateDirectory) -> None:
    path = written(directory)
    assert directory.path.stat().st_mode & 0o777 == 0o700
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_path_that_cannot_be_a_directory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be used for an engine's state: Not a directory"):
        StateDirectory(tmp_path / "file" / "state")


@pytest.mark.parametrize("function", ["open", "ftruncate", "write"])
@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.ENOSPC])
def test_a_directory_that_cannot_be_written_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str, number: int
) -> None:
    def refuse(*arguments: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, function, refuse)
    with pytest.raises(ConfigError, match=f"state: cannot be used for an engine's state: {os.strerror(number)}"):
        StateDirectory(tmp_path / "state")
    monkeypatch.undo()
    StateDirectory(tmp_path / "state").close()


@pytest.mark.long
def test_a_journal_of_any_size_opens_in_bounded_memory(directory: StateDirectory) -> None:
    journal = Journal(directory, {})
    journal.begin_segment({"set": {"values": {}}})
    for number in range(20_000):
        journal.append({"set": {"values": {"0 x": number, "0 text": "x" * 500}}})
    journal.close()
    size = directory.segments()[-1].stat().st_size
    tracemalloc.start()
    found = directory.read()
    assert found is not None
    tables: dict[str, dict[str, object]] = {}
    for change in found.records():
        fold(tables, change)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (found.number, tables["values"]["0 x"]) == (20_001, 19_999)
    assert most < size / 20


def test_a_record_that_is_too_long_to_be_read_again_is_not_written(
    directory: StateDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_LONGEST", 1000)
    journal = Journal(directory, {})
    journal.begin_segment({})
    with pytest.raises(OSError, match="File too large"):
        journal.append({"text": "x" * 1000})
    journal.append({"number": 1})
    journal.close()
    assert changes(directory.segments()[-1]) == [{"number": 1}]


def test_a_segment_that_cannot_be_begun_leaves_the_one_before_in_use(
    directory: StateDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(directory, {})
    journal.begin_segment({})

    def full(name: str, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(directory, "write_file", full)
    with pytest.raises(OSError, match="no room"):
        journal.begin_segment({"state": 1})
    journal.append({"number": 1})
    assert changes(directory.segments()[-1]) == [{"number": 1}]
    journal.close()


def test_growth_is_bounded_by_the_size_of_the_state(directory: StateDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_LEAST", 2000)
    journal = Journal(directory, {})
    journal.begin_segment({"state": "x" * 100})
    longest = 0
    for number in range(500):
        if journal.is_long:
            journal.begin_segment({"state": "x" * 100})
        journal.append({"number": number})
        longest = max(longest, sum(path.stat().st_size for path in directory.segments()))
    assert len(directory.segments()) == 1
    assert longest < 6000
    assert changes(directory.segments()[-1])[-1] == {"number": 499}
    journal.close()


def test_all_who_ask_while_the_disk_is_busy_share_one_write(directory: StateDirectory) -> None:
    writes: list[tuple[Callable[[], object], Done]] = []
    done: list[int] = []

    class SlowDisk(Worker):
        def call(self, function: Callable[[], object], done: Done) -> None:
            writes.append((function, done))

    journal = Journal(directory, {}, SlowDisk)
    journal.begin_segment({})
    for number in range(10):
        journal.append({"number": number})
        journal.sync(partial(done.append, number))
    assert (len(writes), done) == (1, [])
    for count in (1, 10):
        function, told = writes.pop()
        told(*outcome(function))
        assert done == list(range(count))
    assert writes == []
    journal.close()


# ---- why it is no database: docs/durability.md -----------------------------------------------------------------------


def database(path: Path) -> sqlite3.Connection:
    """A database that syncs each commit."""
    made = sqlite3.connect(path, isolation_level=None, timeout=0)
    made.execute("PRAGMA journal_mode=WAL")
    made.execute("PRAGMA synchronous=FULL")
    made.execute("CREATE TABLE IF NOT EXISTS records (number)")
    return made


def test_sqlite_forgets_synced_records_without_an_error(tmp_path: Path) -> None:
    with closing(database(tmp_path / "db")) as one:
        for number in range(5):
            one.execute("INSERT INTO records VALUES (?)", (number,))
        log = bytearray((tmp_path / "db-wal").read_bytes())
        (tmp_path / "copy").write_bytes((tmp_path / "db").read_bytes())
    log[len(log) // 2] ^= 0x55
    (tmp_path / "copy-wal").write_bytes(log)
    with closing(sqlite3.connect(tmp_path / "copy")) as other:
        assert other.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert len(other.execute("SELECT * FROM records").fetchall()) < 5


def test_sqlite_refuses_records_during_a_commit(tmp_path: Path) -> None:
    with closing(database(tmp_path / "db")) as engine, closing(database(tmp_path / "db")) as committer:
        committer.execute("BEGIN IMMEDIATE")  # from here until its commit is on the disk
        with pytest.raises(sqlite3.OperationalError, match="locked"):
            engine.execute("INSERT INTO records VALUES (1)")
