"""The date of second 0: what date timers, scripts and logs count from."""

import json
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
from bpmn_text import process

from fame.bpmn import read_text
from fame.cli import main
from fame.cli.engine import _epoch
from fame.clock import EPOCH, SECOND, Scheduler, parse_epoch
from fame.errors import ConfigError
from fame.scenario import Scenario
from fame.scenario.distributed import TeamOptions, command_lines
from fame.simulation import Simulation

MAY = datetime(2026, 5, 1, 12, tzinfo=UTC)


def write(folder: Path, epoch: str = "", date: str = "2026-05-01T12:00:05Z") -> Path:
    """A scenario whose model waits for a date and tells it."""
    timer = f"<timerEventDefinition><timeDate>{date}</timeDate></timerEventDefinition>"
    (folder / "mission.bpmn").write_text(
        process(
            f"""<startEvent id="s"/><intermediateCatchEvent id="Noon">{timer}</intermediateCatchEvent>
            <scriptTask id="t"><script>log(robot.date)</script></scriptTask>
            <sequenceFlow id="a" sourceRef="s" targetRef="Noon"/>
            <sequenceFlow id="b" sourceRef="Noon" targetRef="t"/>"""
        )
    )
    path = folder / "mission.yaml"
    path.write_text(f"model: mission.bpmn\nduration: 60\n{epoch}\n")
    return path


@pytest.mark.parametrize(
    "text",
    ["2026-05-01T12:00Z", "2026-05-01T12:00:00Z", "'2026-05-01T14:00+02:00'", "2026-05-01 12:00:00"],
)
def test_a_scenario_may_say_it(tmp_path: Path, text: str) -> None:
    scenario = Scenario.load(write(tmp_path, f"epoch: {text}"))
    assert scenario.epoch == MAY
    result = scenario.run()
    assert (result.status, result.simulated) == ("completed", 5.0)
    assert result.reports[-1].detail == "2026-05-01 12:00:05+00:00"
    assert result.to_json()["epoch"] == "2026-05-01T12:00:00Z"


def test_a_date_alone_is_its_midnight_and_now_the_present(tmp_path: Path) -> None:
    assert Scenario.load(write(tmp_path, "epoch: 2026-05-01")).epoch == datetime(2026, 5, 1, tzinfo=UTC)
    before = datetime.now(UTC).replace(microsecond=0)
    assert before <= Scenario.load(write(tmp_path, "epoch: now")).epoch <= datetime.now(UTC)
    assert parse_epoch("now").microsecond == 0


def test_the_caller_has_the_last_word(tmp_path: Path) -> None:
    path = write(tmp_path, "epoch: 2030-01-01")
    assert Scenario.load(path, epoch=MAY).run().status == "completed"
    with pytest.raises(ConfigError, match=r"epoch: expected a datetime with a time zone, got "):
        Scenario.load(path, epoch=datetime(2026, 1, 1))


@pytest.mark.parametrize("text", ["soon", "12", "9999-01-01", "[2026]"])
def test_what_is_no_date_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    assert main(["run", str(write(tmp_path, f"epoch: {text}"))]) == 2
    assert "mission.yaml:3: epoch: " in capsys.readouterr().err
    assert main(["run", str(write(tmp_path)), "--epoch", text]) == 2
    assert "--epoch" in capsys.readouterr().err


def test_the_log_tells_it_and_has_dates_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [tmp_path / "run.jsonl", tmp_path / "run.xes"]
    words = [word for log in logs for word in ("--log", str(log))]
    assert main(["run", str(write(tmp_path)), "--epoch", "2026-05-01T12:00Z", "--quiet", *words]) == 0
    first = json.loads(logs[0].read_text().splitlines()[0])
    assert first | {"detail": "2026-05-01T12:00:00Z", "what": "epoch", "time": 0} == first
    assert 'value="2026-05-01T12:00:05.000000+00:00"' in logs[1].read_text()
    assert main(["run", str(write(tmp_path, date="1970-01-01")), "--quiet", *words]) == 0
    assert "epoch" not in logs[0].read_text()


def test_a_date_beyond_the_duration_is_told_once(tmp_path: Path) -> None:
    result = Scenario.load(write(tmp_path)).run()
    assert (result.status, result.reports[0].element) == ("timeout", "Noon")
    assert result.reports[0].detail == (
        "date timer 2026-05-01T12:00:05Z is due at 2026-05-01T12:00:05Z, and the run goes from 1970-01-01T00:00:00Z "
        "to 1970-01-01T00:01:00Z: see epoch"
    )


@pytest.mark.parametrize("start", [True, False])
def test_a_cycle_that_is_over_is_told(start: bool) -> None:
    timer = "<timerEventDefinition><timeCycle>R3/2026-02-01T00:00:00Z/PT1H</timeCycle></timerEventDefinition>"
    begin = f'<startEvent id="c">{timer}</startEvent>'
    wait = f'<startEvent id="s"/><intermediateCatchEvent id="c">{timer}</intermediateCatchEvent>'
    flow = '<sequenceFlow id="a" sourceRef="s" targetRef="c"/>'
    model = read_text(process(begin if start else wait + flow))
    (report,) = Simulation(model, epoch=MAY).run().reports
    assert (report.element, report.detail) == (
        "c",
        "cycle timer R3/2026-02-01T00:00:00Z/PT1H never fires: its last time was before 2026-05-01T12:00:00Z",
    )


def test_engines_in_processes_of_their_own_have_the_same(tmp_path: Path) -> None:
    scenario = Scenario.load(write(tmp_path, "epoch: 2026-05-01T12:00Z"))
    (line,) = command_lines(scenario, "dds", TeamOptions(), tmp_path / "run.pub").values()
    assert line[line.index("--epoch") + 1] == "2026-05-01T12:00:00Z"
    assert line[line.index("--files") + 1] == str(Path(scenario.definitions.file).resolve().parent)


def test_without_one_an_engine_on_the_wall_clock_knows_the_real_date() -> None:
    scheduler = Scheduler()
    scheduler.run(90 * SECOND)
    assert _epoch(scheduler, simulated=True) == EPOCH  # type: ignore[arg-type]
    before = datetime.now(UTC)
    epoch = _epoch(scheduler, simulated=False)  # type: ignore[arg-type]
    assert before <= epoch + timedelta(seconds=90) <= datetime.now(UTC)


def test_it_may_be_of_any_zone(tmp_path: Path) -> None:
    berlin = MAY.astimezone(timezone(timedelta(hours=2)))
    assert Scenario.load(write(tmp_path), epoch=berlin).run().simulated == 5.0
