"""What docs/extending.md shows is a package that works: its blocks are installed and used by their names."""

from __future__ import annotations

import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from fame.check import Finding, check
from fame.cli import main
from fame.cli.fleet.doctor import packages
from fame.clock import SECOND
from fame.config.loader import registered
from fame.errors import ConfigError
from fame.middleware import DdsMiddleware, messages
from fame.monitor.pipeline.processors import find_class
from fame.scenario import connect, scheduler_for
from sim2d.robot import robot_class

PAGE = (Path(__file__).parent.parent / "docs" / "extending.md").read_text(encoding="utf-8")
SPACES = 'xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:camunda="http://camunda.org/schema/1.0/bpmn"'
MODEL = f"""<definitions {SPACES}>
  <process id="P" isExecutable="true">
    <startEvent id="s"/><serviceTask id="Open" name="Open Door" camunda:topic="open"/><endEvent id="e"/>
    <sequenceFlow id="f1" sourceRef="s" targetRef="Open"/><sequenceFlow id="f2" sourceRef="Open" targetRef="e"/>
  </process>
</definitions>
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def install(folder: Path, entries: dict[str, dict[str, str]], code: str) -> None:
    """A package in a folder of the path, as pip installs it."""
    (folder / "orchard.py").write_text(code, encoding="utf-8")
    information = folder / "orchard-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: orchard\nVersion: 1.0\n")
    lines = [
        f"[{group}]\n" + "\n".join(f"{name} = {place}" for name, place in of.items()) for group, of in entries.items()
    ]
    (information / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture
def orchard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package of the page, installed."""
    install(tmp_path, tomllib.loads(blocks("toml")[0])["project"]["entry-points"], "\n\n".join(blocks("python")))
    monkeypatch.syspath_prepend(tmp_path)
    registered.cache_clear()
    yield tmp_path
    sys.modules.pop("orchard", None)
    registered.cache_clear()


def test_each_example_is_short() -> None:
    assert len(blocks("python")) == 4
    assert all(len(block.splitlines()) <= 40 for block in blocks("python"))


@pytest.mark.usefixtures("orchard")
def test_a_processor_and_a_robot_type_are_found_by_their_names(tmp_path: Path) -> None:
    assert find_class("Power", tmp_path).__module__ == "orchard"
    with pytest.raises(ConfigError, match="got 'Powr'; did you mean 'Power'"):
        find_class("Powr", tmp_path)
    (tmp_path / "world.yaml").write_text(
        "model: drive.bpmn\nworld:\n  size: [40, 4]\n  robots:\n    P: {type: worn_car, at: [1, 1]}\n"
    )
    drive = (
        "async def drive(seconds):\n"
        "    for _ in range(2 * seconds):\n"
        '        robot.publish("cmd_vel", "geometry_msgs/msg/Twist", linear={"x": 0.3})\n'
        "        await sleep(0.5)\n"
        "await drive(58)\n"
        'first = (await receive("odom", timeout=3)).pose.pose.position.x\n'
        "assert first > 10\n"
        "await drive(10)\n"
        'last = (await receive("odom", timeout=3)).pose.pose.position.x\n'
        "assert abs(last - first) < 1\n"
    )
    task = '<serviceTask id="Open" name="Open Door" camunda:topic="open"/>'
    script = f'<scriptTask id="Open" scriptFormat="python"><script>{drive.replace("<", "&lt;")}</script></scriptTask>'
    (tmp_path / "drive.bpmn").write_text(MODEL.replace(task, script))
    assert robot_class("worn_car").__module__ == "orchard"
    assert main(["run", str(tmp_path / "world.yaml"), "--quiet"]) == 0


def test_a_check_finds_what_fame_does_not_look_for(orchard: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = orchard / "door.bpmn"
    model.write_text(MODEL)
    found = [each for each in check(model) if "attach a timer" in each.text]
    assert found == [
        Finding("warning", "waits for ever if nobody answers: attach a timer", str(model), 3, "Open", "Open Door")
    ]
    main(["check", str(model)])
    assert 'door.bpmn:3: warning: "Open Door" (Open): waits for ever' in capsys.readouterr().out


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("def check_patience(definitions):\n    return 1 / 0\n", "failed: ZeroDivisionError: division by zero"),
        ("def check_patience(definitions):\n    return ['slow']\n", "gave something else than findings"),
        ("def check_patience(definitions):\n    raise SystemExit(0)\n", "failed: SystemExit: 0"),
        ("import no_such_module\n", "failed: ConfigError: orchard cannot be imported: ModuleNotFoundError"),
    ],
)
def test_a_check_that_fails_is_an_error_and_no_silence(
    code: str, text: str, orchard: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (orchard / "orchard.py").write_text(code)
    model = orchard / "door.bpmn"
    model.write_text(MODEL)
    assert main(["check", str(model)]) == 2
    assert text in capsys.readouterr().err
    model.write_text(
        MODEL.replace('<serviceTask id="Open" name="Open Door" camunda:topic="open"/>', '<task id="Open"/>')
    )
    assert main(["run", str(model), "--quiet"]) == 0  # which asks no such check


def test_a_package_in_an_archive_is_found(orchard: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loose = registered("fame.checks")
    archive = shutil.make_archive(str(orchard.parent / "orchard"), "zip", orchard)
    monkeypatch.setattr(sys, "path", [archive if path == str(orchard) else path for path in sys.path])
    registered.cache_clear()
    assert registered("fame.checks") == loose != {}


def test_two_packages_with_one_name_are_an_error(orchard: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = orchard / "meadow-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: meadow\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[fame.checks]\npatience = meadow:check\n")
    (orchard / "door.bpmn").write_text(MODEL)
    registered.cache_clear()
    assert main(["check", str(orchard / "door.bpmn")]) == 2
    said = capsys.readouterr().err
    assert "two packages have the name 'patience' in fame.checks" in said
    assert "meadow:check" in said


@pytest.mark.usefixtures("orchard")
def test_a_middleware_is_chosen_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    scheduler = scheduler_for("orchard")
    middleware = connect("orchard", scheduler)
    try:
        assert isinstance(middleware, DdsMiddleware)
        assert middleware.domain == 42
        heard: list[object] = []
        middleware.node("ears").subscription("apples", "std_msgs/msg/Bool", lambda *given: heard.append(given))
        publisher = middleware.node("mouth").publisher("apples", "std_msgs/msg/Bool")
        for _ in range(100):
            publisher.publish(messages.create("std_msgs/msg/Bool", {"data": True}))
            scheduler.run(until=scheduler.now + SECOND // 10)
            if heard:
                break
        assert heard
    finally:
        middleware.close()
    assert next(each.verdict for each in packages("orchard") if each.check == "middleware") == "ok"
    assert main(["topic", "list", "--middleware", "orchad"]) == 2
    assert "got 'orchad'; did you mean 'orchard'?" in capsys.readouterr().err
