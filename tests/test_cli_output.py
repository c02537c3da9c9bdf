"""Lines on stderr, where it is full or closed."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from deployment_field import definitions, process

from fame.cli.output import Notes
from fame.errors import ConfigError
from fame.text import write_file, writing

ROOT = Path(__file__).parent.parent
CODE = "import sys; from fame.cli.output import note; note('one'); note('two'); sys.exit(note.lost)"


class Disk(io.RawIOBase):
    """A file on a disk that is full at times."""

    def __init__(self) -> None:
        self.full, self.text = False, ""

    def writable(self) -> bool:
        return True

    def write(self, data) -> int:
        if self.full:
            raise OSError(28, "No space left on device")
        self.text += bytes(data).decode()
        return len(data)


def test_what_could_not_be_written_is_counted_and_said_when_it_can(monkeypatch):
    disk, note = Disk(), Notes()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(io.BufferedWriter(disk), encoding="utf-8"))
    note("a")
    disk.full = True
    note("b")
    note("c")
    assert note.lost == 2
    disk.full = False
    note("d\x1b[2J")
    assert note.lost == 0
    assert disk.text.splitlines() == ["a", "", "(2 lines before this one could not be written)", "d\\x1b[2J"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_a_full_disk_ends_no_process():
    with open("/dev/full", "w") as full:
        assert subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, stderr=full, check=False).returncode == 2


def test_a_closed_pipe_ends_no_process():
    reading, writing = os.pipe()
    os.close(reading)
    try:
        assert subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, stderr=writing, check=False).returncode == 2
    finally:
        os.close(writing)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_a_mission_is_completed_though_nobody_can_read_its_log(tmp_path):
    model = tmp_path / "m.bpmn"
    script = '<scriptTask id="t"><script>log("hello")</script></scriptTask>'
    model.write_text(definitions(process("p", f'<startEvent id="s"/>{script}', ("s", "t"))))
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "fame", "run", str(model)],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=full, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 0
    assert "completed" in done.stdout


def test_a_file_is_replaced_when_it_is_whole_and_a_link_or_a_device_stays_one(tmp_path: Path) -> None:
    old, link, device = tmp_path / "old.txt", tmp_path / "link.txt", tmp_path / "device"
    old.write_text("old")
    link.symlink_to(old)

    def fail() -> None:
        with writing(link) as part:
            part.write_text("ha")
            raise OSError("full")

    with pytest.raises(ConfigError, match=r"link\.txt: cannot be written: full"):
        fail()
    assert old.read_text() == "old"
    write_file(link, "new")
    assert (link.is_symlink(), old.read_text(), sorted(path.name for path in tmp_path.iterdir())) == (
        True, "new", ["link.txt", "old.txt"],
    )  # fmt: skip
    os.mkfifo(device)
    with writing(device) as part:
        assert part == device
    assert device.is_fifo()
    with writing("/dev/stdout") as part:
        assert part == Path("/dev/stdout")


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o755])
def test_a_file_that_is_replaced_keeps_its_mode_and_owner(mode: int, tmp_path: Path) -> None:
    file = tmp_path / "secret.txt"
    file.write_text("old")
    file.chmod(mode)
    os.utime(file, (0, 0))
    owner = (1234, 2345) if os.geteuid() == 0 else (os.geteuid(), os.getegid())
    os.chown(file, *owner)
    with writing(file) as part:
        part.write_text("new")
        assert part.parent.stat().st_mode & 0o777 == 0o700  # nobody reads it meanwhile
    found = file.stat()
    assert (file.read_text(), found.st_mode & 0o777, found.st_uid, found.st_gid) == ("new", mode, *owner)
    assert found.st_mtime > 0
    assert list(tmp_path.iterdir()) == [file]


def test_a_write_protected_file_is_refused_before_the_work(tmp_path: Path) -> None:
    file = tmp_path / "kept.txt"
    file.write_text("old")
    file.chmod(0o444)
    begun = []
    with (
        pytest.raises(ConfigError, match=r"kept\.txt: cannot be written: it is write-protected$"),
        writing(file) as part,
    ):
        begun.append(part)
    assert (begun, file.read_text()) == ([], "old")
