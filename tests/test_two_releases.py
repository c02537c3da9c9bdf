"""A team of which one robot runs the last release deploys, migrates, completes, is taken over and updated."""

import json
import os
import signal
import subprocess
import sys
import time
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document
from domains import PROCESSES
from middleware_contract import needs

ROOT = Path(__file__).parent.parent
LAST = "d8d158a7"
"""The commit of the last release, 0.2.0."""
PATIENCE = 120.0
pytestmark = [needs("cyclonedds"), pytest.mark.dds, pytest.mark.processes, pytest.mark.long]
MODEL = document(
    '<signal id="G" name="go"/><collaboration id="C"><participant id="pA" name="A" processRef="a"/>'
    '<participant id="pB" name="B" processRef="b"/></collaboration>'
    '<process id="a" isExecutable="true"><startEvent id="sa"/><userTask id="first"/>'
    '<intermediateThrowEvent id="go"><signalEventDefinition signalRef="G"/></intermediateThrowEvent>'
    '<userTask id="last"><extensionElements><camunda:inputOutput><camunda:inputParameter name="n">${1 + 1}'
    "</camunda:inputParameter></camunda:inputOutput></extensionElements></userTask>"
    '<sequenceFlow id="f0" sourceRef="sa" targetRef="first"/>'
    '<sequenceFlow id="f1" sourceRef="first" targetRef="go"/><sequenceFlow id="f2" sourceRef="go" targetRef="last"/>'
    '</process><process id="b" isExecutable="true"><startEvent id="sb"/><intermediateCatchEvent id="wait">'
    '<signalEventDefinition signalRef="G"/></intermediateCatchEvent><userTask id="end"/>'
    '<sequenceFlow id="f3" sourceRef="sb" targetRef="wait"/><sequenceFlow id="f4" sourceRef="wait" targetRef="end"/>'
    "</process>"
)


@pytest.fixture(scope="module")
def last(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment in which the wheel of the last release is installed."""
    folder = tmp_path_factory.mktemp("last")
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", LAST], capture_output=True, check=False)
    if archive.returncode:
        pytest.skip(f"the last release cannot be built: this clone has no commit {LAST}")
    (folder / "source").mkdir()
    subprocess.run(["tar", "x", "-C", str(folder / "source")], input=archive.stdout, check=True)
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    built = subprocess.run([*build, str(folder / "source")], capture_output=True, text=True, check=False)
    if built.returncode:
        pytest.skip(f"the last release cannot be built: {built.stderr.strip().splitlines()[-1]}")
    venv.create(folder / "env", with_pip=False)
    (packages,) = (folder / "env").glob("lib/python*/site-packages")
    zipfile.ZipFile(next(folder.glob("*.whl"))).extractall(packages)
    (packages / "others.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    return folder / "env" / "bin" / "python"


class Team:
    """Robots in processes of their own, each with one of two versions of FAME, and the commands of both."""

    def __init__(self, last: Path, folder: Path) -> None:
        self.pythons = {"last": str(last), "this": sys.executable}
        self.folder, self.engines = folder, dict[str, subprocess.Popen[str]]()
        paths = {"last": "", "this": str(ROOT)}
        self.environments = {
            which: os.environ | {"ROS_DOMAIN_ID": str(PROCESSES), "PYTHONPATH": path} for which, path in paths.items()
        }

    def words(self, which: str, *words: str) -> list[str]:
        return [self.pythons[which], "-P", "-m", "fame", *words]

    def start(self, robot: str, which: str, *options: str) -> None:
        words = self.words(which, "engine", robot, "--state", str(self.folder / robot), *options)
        log = (self.folder / f"{robot}.log").open("a")
        with log:
            self.engines[robot] = subprocess.Popen(words, env=self.environments[which], stderr=log, cwd=self.folder)

    def kill(self, robot: str) -> None:
        self.engines[robot].kill()
        self.engines[robot].wait()

    def run(self, which: str, *words: str) -> str:
        done = subprocess.run(
            self.words(which, *words), env=self.environments[which], capture_output=True, text=True,
            timeout=PATIENCE, check=False, cwd=self.folder,
        )  # fmt: skip
        assert done.returncode == 0, (which, words, done.stdout, done.stderr, self.log())
        return done.stdout

    def log(self) -> str:
        return "".join(path.read_text() for path in self.folder.glob("*.log"))

    def tokens(self, which: str = "this") -> dict[str, str]:
        """Where the token of each robot is; its state, where it has none."""
        done = subprocess.run(
            self.words(which, "status", "--json"), env=self.environments[which], capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        robots: dict[str, Any] = json.loads(done.stdout).get("robots", {}) if done.stdout else {}
        return {
            name: (report["waits"] or [{"element": report["state"]}])[0]["element"] for name, report in robots.items()
        }

    def expect(self, which: str = "this", **tokens: str) -> None:
        until, found = time.monotonic() + PATIENCE, self.tokens(which)
        while found != tokens and time.monotonic() < until:
            found = self.tokens(which)
        assert found == tokens, self.log()


@pytest.fixture
def team(last: Path, tmp_path: Path) -> Iterator[Team]:
    made = Team(last, tmp_path)
    yield made
    for robot in made.engines:
        made.kill(robot)


@pytest.mark.parametrize(("sender", "person"), [("this", "last"), ("last", "this")])
@pytest.mark.parametrize("keys", [False, True], ids=["open", "signed"])
def test_a_team_of_two_releases_does_all_that_one_of_one_release_does(
    team: Team, sender: str, person: str, keys: bool
) -> None:
    assert team.run("last", "--version") == "fame 0.2.0\n"
    folder, key, trust = team.folder, list[str](), list[str]()
    if keys:
        team.run("last", "keys", "new", "team")
        key, trust = ["--key", "team.key"], ["--trust", "team.pub"]
    (folder / "team.bpmn").write_text(MODEL)
    (folder / "changed.bpmn").write_text(MODEL.replace('<userTask id="end"/>', '<userTask id="end" name="End"/>'))
    for robot, which in (("A", "last"), ("B", "this")):
        team.start(robot, which, *trust)
    team.expect(A="waiting", B="waiting")
    team.run(sender, "deploy", "team.bpmn", "--wait", "60", *key)
    team.expect(person, A="first", B="wait")
    for words, text in (
        (["status", "--why", "A"], "events of A are not read: {}"),
        (["deploy", "changed.bpmn", "--rollback-unless-ended", "60", *key], "-ended is not possible: {}"),
    ):
        done = subprocess.run(
            team.words("this", *words), env=team.environments["this"], capture_output=True, text=True,
            timeout=PATIENCE, check=False, cwd=folder,
        )  # fmt: skip
        assert text.format("A runs an older FAME (protocol 1); this speaks 2: update A") in done.stderr
    team.expect(person, A="first", B="wait")
    team.run(sender, "deploy", "changed.bpmn", "--migrate", "--wait", "60", *key)
    team.run(person, "complete", "A", "first", *key)
    team.expect(sender, A="last", B="end")
    for robot in ("A", "B"):
        words = team.words(person, "take-over", robot, *key)
        environment = team.environments[person]
        with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True, cwd=folder) as taking:
            assert taking.stdout is not None
            assert "taken over" in taking.stdout.readline(), team.log()
            taking.send_signal(signal.SIGINT)
            taking.wait(PATIENCE)
        team.run(sender, "continue", robot, *key)
    team.kill("A")
    team.start("A", "this", *trust)  # an update in mid-mission
    team.expect(A="last", B="end")
    team.run(person, "complete", "A", "last", *key)
    team.run(sender, "complete", "B", "end", *key)
    team.expect(person, A="idle", B="idle")
