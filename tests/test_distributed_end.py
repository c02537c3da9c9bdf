"""A team in processes has ended when each of its robots says so: here in simulated time, and in one process."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from deployment_field import ERROR, job

from fame import Scenario
from fame.clock import SECOND, Scheduler
from fame.deploy import Deployment, EngineNode
from fame.deploy.authentication import ReportReader
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.deploy.signing import read_trusted
from fame.middleware.local import LocalMiddleware
from fame.scenario import DistributedTeam, Result, distributed


class Engines:
    """Engines, in place of child processes."""

    def __init__(self, scheduler: Scheduler, middleware: LocalMiddleware) -> None:
        self._scheduler, self._middleware = scheduler, middleware

    def start(self, name: str, arguments: list[str]) -> None:
        options = EngineOptions(trusted=read_trusted([Path(arguments[arguments.index("--trust") + 1])]))
        EngineNode(name, scheduler=self._scheduler, middleware=self._middleware, options=options)

    def pid(self, name: str) -> int:
        return 0

    def ended(self) -> dict[str, str]:
        return {}

    def end(self) -> list[str]:
        return []


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Runs a `job` with a team that does not hear B between two times after the start (s)."""

    def run_it(work: float, end: str, *, deaf: tuple[float, float] = (0, 0), duration: float = 60) -> Result:
        scheduler = Scheduler()
        middleware = LocalMiddleware(scheduler)
        monkeypatch.setattr(distributed, "scheduler_for", lambda backend: scheduler)
        monkeypatch.setattr(distributed, "connect", lambda backend, scheduler: middleware)
        monkeypatch.setattr(distributed, "Subprocesses", lambda on_line: Engines(scheduler, middleware))

        class Team(DistributedTeam):
            def _on_report(self, reader: ReportReader, message: Any) -> None:
                begun = self._until - self.scenario.duration
                if not (reader.robot == "B" and deaf[0] <= scheduler.now / SECOND - begun < deaf[1]):
                    super()._on_report(reader, message)

        path = tmp_path / "team.bpmn"
        path.write_text(job(4, work, end))
        return Team(Scenario.load(path, duration=duration), "dds").run()

    return run_it


def test_it_ends_when_all_have_said_so(run: Callable[..., Result]) -> None:
    result = run(1, "")
    assert (result.status, result.robots[1].instances) == ("completed", 2)
    assert 5 <= result.simulated < 10


def test_a_robot_that_works_on_without_a_report_of_it_yet_has_not_ended(run: Callable[..., Result]) -> None:
    result = run(20, "")
    assert (result.status, result.robots[1].completed) == ("completed", 2)


def test_a_robot_that_is_not_heard_since_the_others_ended_has_not_ended(run: Callable[..., Result]) -> None:
    result = run(1, ERROR, deaf=(2, 9))
    assert (result.status, result.exit_code) == ("failed", 1)
    assert result.messages[0].endswith("team.bpmn:1): error broken was not caught")


def test_of_a_robot_that_is_not_heard_until_the_duration_is_over_nothing_is_known(run: Callable[..., Result]) -> None:
    result = run(1, ERROR, deaf=(2, 1000), duration=30)
    assert (result.status, result.exit_code) == ("failed", 1)
    assert result.messages[0].startswith("B: its engine has been silent for ")


def test_what_seems_over_when_the_duration_is_over_is_confirmed_first(run: Callable[..., Result]) -> None:
    assert run(1, "", duration=5.2).status == "completed"
    assert run(1, ERROR, deaf=(2, 6), duration=4.6).status == "failed"


def test_on_a_busy_machine_it_waits_longer_for_answers(
    run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    class Noted(Deployment):
        def __init__(self, *given: Any, options: DeploymentOptions, **named: Any) -> None:
            waits.append(options.patience_of(2))
            super().__init__(*given, options=options, **named)

    monkeypatch.setattr(distributed, "Deployment", Noted)
    monkeypatch.setattr(os, "getloadavg", lambda: (3.0 * (os.cpu_count() or 1), 0.0, 0.0))
    assert (run(1, "").status, waits) == ("completed", [30.0])
