"""Engines with a state directory, from the command line: repair with keys, and directories that cannot be used."""

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from bpmn_text import document
from middleware_contract import needs
from test_killed_engines import ENVIRONMENT, ROOT, TICKS, fame, told

from fame.robot.journal import Journal, StateDirectory

pytestmark = [needs("cyclonedds"), pytest.mark.dds, pytest.mark.processes]

FAILING = document(
    '<collaboration id="C"><participant id="A" name="REX" processRef="p"/></collaboration>'
    '<process id="p" isExecutable="true"><startEvent id="s"/><scriptTask id="z"><script>x = 0</script></scriptTask>'
    '<scriptTask id="a" name="Divide"><script>y = 10 / x</script></scriptTask><userTask id="u"/><userTask id="v"/>'
    + "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ["sz", "za", "au", "uv"])
    + "</process>"
)


class Engine:
    """An engine in a process of its own, whose words are kept in a file."""

    def __init__(self, folder: Path, *words: str, largest: int | None = None) -> None:
        """`largest`: the largest file that it can write (kB)."""
        self.said = folder / "said"
        limit = ["bash", "-c", f'ulimit -f {largest} && exec "$@"', "_"] if largest is not None else []
        with self.said.open("ab") as file:
            self.process = subprocess.Popen([*limit, *fame("engine", "REX", *words)], env=ENVIRONMENT, stderr=file)

    def until(self, text: str) -> str:
        """What it has said, as soon as the text is in it."""
        until = time.monotonic() + 60
        while text not in (said := self.said.read_text()) and time.monotonic() < until:
            assert self.process.poll() is None, said
            time.sleep(0.05)
        assert text in said
        return said

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def engines() -> Iterator[list[Engine]]:
    made: list[Engine] = []
    yield made
    for engine in made:
        engine.end()


def until_status(text: str) -> None:
    """Ask for the status until the text is in it: on a busy machine an engine is not found at once."""
    until = time.monotonic() + 60
    while True:
        done = subprocess.run(fame("status"), env=ENVIRONMENT, capture_output=True, text=True, timeout=60, check=False)
        if text in done.stdout:
            return
        assert time.monotonic() < until, done


def refused(*words: str) -> str:
    """What a command says that ends with exit code 1 or 2."""
    done = subprocess.run(fame(*words), env=ENVIRONMENT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode in (1, 2), done
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def taking_over() -> subprocess.Popen[str]:
    """A process that has taken the robot over, or has ended."""
    words = fame("take-over", "REX", "--wait", "30")
    taking = subprocess.Popen(words, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert taking.stderr is not None
    if "on /REX/cmd_vel_manual" not in taking.stderr.readline():
        taking.wait(timeout=60)
    return taking


def test_a_robot_is_taken_over_until_ctrl_c_and_stays_suspended(tmp_path: Path, engines: list[Engine]) -> None:
    (tmp_path / "m.bpmn").write_text(FAILING.replace("x = 0", "x = 1"))
    engines.append(Engine(tmp_path))
    told("deploy", str(tmp_path / "m.bpmn"), "--wait", "30")
    both = [taking_over()]
    time.sleep(4)  # longer than a lease that nobody prolongs
    both.append(taking_over())
    for one in both:
        one.send_signal(signal.SIGINT)  # to one that has ended: nothing
    (held, _), (other, _) = [one.communicate(timeout=60) for one in both]
    codes = [one.returncode for one in both]
    if "steers no longer: lost" not in engines[0].said.read_text():
        assert (held, codes) == ("REX: taken over: REX\nREX: suspended: REX\n", [0, 1])
        assert "steers it; fame suspend stops it" in other
    else:  # the holder had no processor for as long as a lease, and was told so unless Ctrl-C came first
        assert held.startswith("REX: taken over: REX\n")
        assert codes[0] == (0 if "suspended" in held else 1)
    until_status("suspended by")
    told("continue", "REX", "--wait", "30")


def test_repairs_are_signed_where_keys_are_used_and_the_journal_says_whose_key_it_was(
    tmp_path: Path, engines: list[Engine]
) -> None:
    told("keys", "new", str(tmp_path / "team"))
    key, public, state = str(tmp_path / "team.key"), str(tmp_path / "team.pub"), tmp_path / "state"
    (tmp_path / "m.bpmn").write_text(FAILING)
    engines.append(Engine(tmp_path, "--trust", public, "--state", str(state), "--on-error", "hold"))
    told("deploy", str(tmp_path / "m.bpmn"), "--key", key, "--wait", "30")
    engines[0].until("incident: ZeroDivisionError")
    until_status("fame retry REX a")
    assert "signed" in refused("retry", "REX", "a", "--set", "x=2")
    told("retry", "REX", "a", "--set", "x=2", "--key", key)
    told("set", "REX", "x=5", "--key", key)
    told("move", "REX", "u", "v", "--key", key)
    said = engines[0].until("moved to v by")
    who = said.partition("retried x=2 by ")[2].splitlines()[0]
    assert ", key " in who  # the person, then the key
    assert "unverified" not in said
    assert f"set x=5 by {who}" in said
    journal = "".join(path.read_text() for path in state.glob("journal-*"))
    assert f"a: retried x=2 by {who}" in journal
    assert f"u: moved to v by {who}" in journal


def test_a_suspended_robot_that_is_started_again_stays_suspended_until_a_signed_request_continues_it(
    tmp_path: Path, engines: list[Engine]
) -> None:
    told("keys", "new", str(tmp_path / "team"))
    key, words = str(tmp_path / "team.key"), ("--trust", str(tmp_path / "team.pub"), "--state", str(tmp_path / "state"))
    (tmp_path / "m.bpmn").write_text(FAILING.replace("x = 0", "x = 1"))
    engines.append(Engine(tmp_path, *words))
    told("deploy", str(tmp_path / "m.bpmn"), "--key", key, "--wait", "30")
    assert "signed" in refused("suspend", "REX")
    assert "REX: suspended: REX" in told("suspend", "REX", "--key", key)
    until_status("fame continue REX ends that")
    engines[0].end()
    engines.append(Engine(tmp_path, *words))
    engines[1].until("continues its mission")
    until_status("fame continue REX ends that")
    who = engines[1].said.read_text().partition("suspended by ")[2].splitlines()[0]
    assert ", key " in who
    assert f"suspended by {who}" in told("status", "--why", "REX")
    assert "signed" in refused("continue", "REX")
    assert "signed" in refused("skip", "REX", "u")
    assert "REX: skipped: u" in told("skip", "REX", "u", "--key", key)
    assert "REX: continued: REX" in told("continue", "REX", "--key", key)
    until_status("running")
    assert "waits at v" in told("status", "--why", "REX")


def test_of_two_engines_on_one_directory_the_second_is_refused(tmp_path: Path, engines: list[Engine]) -> None:
    state = StateDirectory(tmp_path / "state")
    assert f"is in use by another engine (process {os.getpid()})" in refused(
        "engine", "REX", "--state", str(tmp_path / "state")
    )
    state.close()


def test_directories_that_cannot_be_used_are_refused_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "cannot be used for an engine's state" in refused("engine", "REX", "--state", str(tmp_path / "file"))
    assert "cannot be used for an engine's state" in refused("engine", "REX", "--state", "/proc/nowhere")
    run = ("run", str(ROOT / "examples/ground_vehicles.yaml"), "--middleware", "dds", "--state", str(tmp_path / "file"))
    assert "REX: cannot be used for an engine's state: Not a directory" in refused(*run)
    assert "--fresh needs --state" in refused("engine", "REX", "--fresh")
    state = tmp_path / "state"
    state.mkdir()
    (state / "journal-00000001").write_bytes(b"something else\n")
    assert "is not a journal of a FAME engine" in refused("engine", "REX", "--state", str(state))
    directory = StateDirectory(tmp_path / "other")
    journal = Journal(directory, {"robot": "DINGO"})
    journal.begin_segment({})
    journal.close()
    directory.close()
    text = refused("engine", "REX", "--state", str(tmp_path / "other"))
    assert "is the state of robot 'DINGO', not of 'REX'" in text


def test_a_full_disk_holds_the_robot_until_there_is_room(tmp_path: Path, engines: list[Engine]) -> None:
    """The engine may write files of 40 kB: to its journal this is a full disk, until the state is written anew."""
    model = TICKS.replace("n &lt; 60", "n &lt; 100000")
    model = model.replace('with open(FILE, "a") as file: file.write(f"{n}\\n")', "")
    assert "FILE" not in model
    (tmp_path / "m.bpmn").write_text(model)
    engines.append(Engine(tmp_path, "--state", str(tmp_path / "state"), largest=40))
    told("deploy", str(tmp_path / "m.bpmn"), "--wait", "30")
    engines[0].until("holds: its state cannot be written: No space left on device")
    engines[0].until("continues: its state can be written again")
    until_status("running")
