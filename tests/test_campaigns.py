"""Campaigns: what varies, the runs, their folder, the statistics; each failure has a cause and can be repeated."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from bpmn_text import process, properties

from fame.campaign.report import (
    causes,
    counted,
    html_report,
    importance,
    interval,
    summary,
    text_report,
    write_reports,
)
from fame.campaign.runs import Campaign, Folder, _measured, _Variables, cause_of, run_campaign
from fame.campaign.variation import FAULTS, Distribution, Variation, points, read_variation
from fame.cli import main
from fame.errors import ConfigError, FameError
from fame.log import Recording
from fame.scenario.plan import changed
from fame.scenario.scenario import Scenario
from fame.view import HeatMap

ROOT = Path(__file__).parent.parent
FLOW = '<sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
DATA = (
    f'<dataObjectReference id="o" dataObjectRef="d">{properties(speed="0.5")}</dataObjectReference><dataObject id="d"/>'
)
SCRIPT = """await sleep(1 / speed)
if speed &gt; 0.9:
    raise BpmnError("slipped")
far = speed * 2
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    """A robot whose speed decides how long it takes, and whether it slips."""
    arrow = '<dataInputAssociation id="a"><sourceRef>o</sourceRef><targetRef>p</targetRef></dataInputAssociation>'
    task = f'<scriptTask id="t" name="Go">{arrow}<script>{SCRIPT}</script></scriptTask>'
    (tmp_path / "m.bpmn").write_text(process(f'<startEvent id="s"/>{task}{FLOW}{DATA}'))
    path = tmp_path / "s.yaml"
    path.write_text("model: m.bpmn\ncomputers: [P]\n")
    return path


def speeds(low: float, high: float, **measures: str) -> Variation:
    return Variation((Distribution("variables.P.speed", "uniform", (low, high)),), "random", measures)


def rows_of(campaign: Campaign, folder: Path, **options: Any) -> list[dict[str, Any]]:
    place = Folder(folder)
    place.begin(campaign)
    return sorted(run_campaign(campaign, place, **options), key=lambda row: row["run"])


# ---- what varies -----------------------------------------------------------------------------------------------------


def values(variation: Variation, runs: int, seed: int = 1) -> list[dict[str, Any]]:
    return list(points(variation, runs, seed, None))


def test_the_same_seed_gives_the_same_values_and_more_runs_begin_with_them() -> None:
    both = Variation((Distribution("a", "normal", (5, 1)), Distribution("b", "integer", (1, 3))))
    few, many = values(both, 10), values(both, 200)
    assert many[:10] == few == values(both, 10) != values(both, 10, seed=2)
    assert {one["b"] for one in many} == {1, 2, 3}
    assert abs(sum(one["a"] for one in many) / 200 - 5) < 0.3


def test_a_latin_hypercube_spreads_evenly_and_a_factorial_design_takes_every_combination() -> None:
    latin = Variation((Distribution("a", "uniform", (0, 10)), Distribution("b", "uniform", (0, 1))), "latin")
    assert sorted(int(one["a"]) for one in values(latin, 10)) == list(range(10))
    choices = (Distribution("a", "choice", choices=(1, 2)), Distribution("b", "choice", choices=("x", "y", "z")))
    found = [tuple(one.values()) for one in values(Variation(choices, "factorial"), 7)]
    assert len(set(found)) == 6
    assert found[6] == found[0]


def test_a_file_says_it_and_what_is_wrong_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(
        "vary:\n  network.loss: {uniform: [0, 0.1]}\n  faults: {choice: [none, REX@1:engine]}\nmeasure: {x: P.x}\n"
    )
    found = read_variation(path)
    assert [(one.path, one.kind) for one in found.distributions] == [("network.loss", "uniform"), ("faults", "choice")]
    assert found.measures == {"x": "P.x"}
    wrong = {
        "vary:\n  a: {gamma: [1, 2]}": r"c.yaml:2: .*gamma",
        "vary:\n  a: [1, 2]": r"c.yaml:2: vary.a: expected one of uniform",
        "vary:\n  a: {uniform: [2, 1]}": r"expected two numbers, the smaller one first",
        "vary:\n  a: {uniform: [0, 1]}\ndesign: factorial": r"a factorial design has choices only",
        "design: sobol": r"c.yaml:1: design",
        "varry: {}": r"varry",
    }
    for text, error in wrong.items():
        path.write_text(text)
        with pytest.raises(ConfigError, match=error):
            read_variation(path)


def test_a_path_names_a_value_of_the_scenario() -> None:
    data = {"world": {"weeds": [{"name": "dock", "at": [1, 2]}], "robots": {"REX": {"at": [0, 0]}}}}
    changes = {"world.weeds.dock.at": [3, 4], "world.robots.REX.at": [5, 6], "network.loss": 0.1, "seed": 7}
    found = changed(data, changes, "s.yaml")
    assert found["world"] == {"weeds": [{"name": "dock", "at": [3, 4]}], "robots": {"REX": {"at": [5, 6]}}}
    assert (found["network"], found["seed"], data["world"]["robots"]["REX"]["at"]) == ({"loss": 0.1}, 7, [0, 0])
    for path in ("world.robots.REKS.at", "world.weeds.thistle.at", "wurld.size"):
        with pytest.raises(ConfigError, match=r"s.yaml: .*the scenario has no"):
            changed(data, {path: 1}, "s.yaml")


def test_free_ground_is_clear_of_obstacles(tmp_path: Path) -> None:
    from sim2d.config import read_world

    path = tmp_path / "w.yaml"
    path.write_text("size: [6, 4]\nobstacles: [{name: rock, at: [3, 2], radius: 1}]\n")
    variation = Variation((Distribution("world.robots.REX.at", "free", (0.5,)),))
    for one in points(variation, 100, 1, read_world(path)):
        x, y = one["world.robots.REX.at"]
        assert 0.4 < x < 5.6
        assert (x - 3) ** 2 + (y - 2) ** 2 > 1.4**2
    with pytest.raises(ConfigError, match="no ground is 9 m from all obstacles"):
        next(points(Variation((Distribution("a", "free", (9.0,)),)), 1, 1, read_world(path)))


# ---- runs ------------------------------------------------------------------------------------------------------------


def test_each_run_has_its_seed_values_and_measures_and_a_command_that_repeats_it(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = Campaign(
        scenario=str(scenario), runs=12, variation=speeds(0.2, 1.2, far="P.far", none="P.nothing"), workers=1
    )
    rows = rows_of(campaign, tmp_path / "out")
    assert [row["seed"] for row in rows] == list(range(1, 13))
    assert {row["status"] for row in rows} == {"completed", "failed"}
    for row in rows:
        speed = row["changes"]["variables.P.speed"]
        assert row["status"] == ("failed" if speed > 0.9 else "completed")
        assert row["duration"] == pytest.approx(1 / speed, abs=1e-6)
        assert row["measure.far"] == (None if speed > 0.9 else pytest.approx(2 * speed))
        assert row["measure.none"] is None
    failed = next(row for row in rows if row["status"] == "failed")
    assert failed["cause"] == "P failed at t: slipped"
    assert main([*shlex.split(failed["command"])[1:], "--json"]) == 1
    again = json.loads(capsys.readouterr().out)
    assert again["simulated"] == pytest.approx(failed["duration"], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Q.far", "unknown robot Q; robots are: P"),
        ("P.far +", "measure.far"),
        ("1 + 1", "measure.far: expected variables of its robots (P), got 1 + 1"),
    ],
)
def test_a_measure_that_no_run_can_have_is_refused(scenario: Path, text: str, said: str) -> None:
    with pytest.raises(FameError, match=re.escape(said)):
        Campaign(scenario=str(scenario), runs=1, variation=speeds(0.2, 1.2, far=text)).check()


def test_an_impossible_world_is_counted_apart(tmp_path: Path, scenario: Path) -> None:
    scenario.write_text(
        "model: m.bpmn\nworld:\n  size: [6, 4]\n  obstacles: [{name: rock, at: [3, 2], radius: 1}]\n"
        "  robots:\n    P: {type: car, at: [1, 1]}\n"
    )
    variation = Variation((Distribution("world.robots.P.at", "choice", choices=([1, 1], [3, 2])),), "factorial")
    rows = rows_of(Campaign(scenario=str(scenario), runs=4, variation=variation, workers=1), tmp_path / "out")
    assert [row["status"] for row in rows] == ["completed", "impossible"] * 2
    found = summary(rows)
    assert (found["probability"], found["statuses"]["impossible"]) == (1.0, 2)
    assert "rock" in found["causes"][0]["cause"]
    assert rows[0]["distance"] == 0


@pytest.mark.parametrize(
    ("path", "code", "text"),
    [
        ("variables.P.sped", 2, "P has no variable 'sped'; did you mean 'speed'?"),
        ("variables.sped", 2, "the mission has no variable 'sped'; did you mean 'speed'?"),
        ("variables.Q.speed", 2, "unknown robot 'Q' in variables"),
        ("world.robots.P.at", 1, "2 x impossible"),
    ],
)
def test_what_cannot_be_varied_is_refused_and_a_campaign_without_a_possible_run_fails(
    path: str, code: int, text: str, tmp_path: Path, scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario.write_text("model: m.bpmn\nworld:\n  size: [6, 4]\n  robots:\n    P: {type: car, at: [1, 1]}\n")
    (tmp_path / "vary.yaml").write_text(f"vary:\n  {path}: {{choice: [[9, 9]]}}\n")
    options = ["--runs", "2", "--jobs", "1", "--vary", str(tmp_path / "vary.yaml"), "-o", str(tmp_path / "out")]
    assert main(["campaign", str(scenario), *options]) == code
    shown = capsys.readouterr()
    assert text in shown.out + shown.err


def test_the_way_that_robots_go_is_measured(tmp_path: Path) -> None:
    campaign = Campaign(scenario=str(ROOT / "examples" / "ground_vehicles.yaml"), runs=1, duration=20, workers=1)
    (row,) = rows_of(campaign, tmp_path / "out")
    assert 1 < row["distance"] < 20


def test_a_broken_model_stops_before_the_first_run(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.bpmn").write_text(
        process('<startEvent id="s"/><scriptTask id="t"><script>x = = 1</script></scriptTask>' + FLOW)
    )
    scenario.write_text("model: m.bpmn\n")
    out = tmp_path / "out"
    assert main(["campaign", str(scenario), "--runs", "1000", "-o", str(out)]) == 2
    assert "m.bpmn:" in capsys.readouterr().err
    assert not out.exists()


def test_a_script_that_fails_in_the_first_run_ends_the_campaign(
    tmp_path: Path, scenario: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.bpmn").write_text(
        process(f'<startEvent id="s"/><scriptTask id="t"><script>x = [][0]</script></scriptTask>{FLOW}')
    )
    scenario.write_text("model: m.bpmn\ncomputers: [P]\n")
    out = tmp_path / "out"
    assert main(["campaign", str(scenario), "--runs", "1000", "--jobs", "1", "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"a script fails in the first run: P failed at t: script; see fame run {scenario} --seed 1" in said
    assert len(Folder(out).rows()) == 1
    assert f"to continue nevertheless: fame campaign --resume {out}" in said


@pytest.mark.long
def test_a_process_that_dies_is_tried_again(scenario: Path, tmp_path: Path) -> None:
    script = f"""import os
if {str(tmp_path / "died")!r} not in [str(one) for one in __import__('pathlib').Path({str(tmp_path)!r}).iterdir()]:
    open({str(tmp_path / "died")!r}, "w").close()
    os._exit(9)
"""
    task = f'<scriptTask id="t"><script>{script}</script></scriptTask>'
    (tmp_path / "m.bpmn").write_text(process(f'<startEvent id="s"/>{task}{FLOW}'))
    scenario.write_text("model: m.bpmn\ncomputers: [P]\n")
    rows = rows_of(Campaign(scenario=str(scenario), runs=3, workers=2), tmp_path / "out")
    assert [row["status"] for row in rows] == ["completed"] * 3


@pytest.mark.long
def test_a_campaign_goes_on_where_it_was_interrupted(scenario: Path, tmp_path: Path) -> None:
    campaign = Campaign(scenario=str(scenario), runs=8, variation=speeds(0.2, 1.2), workers=1)
    folder = Folder(tmp_path / "out")
    folder.begin(campaign)
    seen: list[int] = []

    def stop(rows: Sequence[Any]) -> None:
        seen.append(len(rows))
        if len(rows) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(campaign, folder, progress=stop)
    with (folder.path / "runs.jsonl").open("a") as file:
        file.write('{"run": 4, "sta')  # cut off
        file.write("\n")
    assert folder.campaign() == campaign
    rows = run_campaign(folder.campaign(), folder)
    assert sorted(row["run"] for row in rows) == list(range(1, 9))
    assert len(folder.rows()) == 8


def test_ctrl_c_in_the_middle_of_a_run_ends_the_campaign_and_that_run_is_done_again(
    scenario: Path, tmp_path: Path
) -> None:
    script = f"""import os, pathlib, signal
begun = pathlib.Path({str(tmp_path / "begun")!r})
begun.write_text("x" + (begun.read_text() if begun.exists() else ""))
if begun.read_text() == "xxx":
    os.kill(os.getpid(), signal.SIGINT)
await sleep(1)
"""
    (tmp_path / "m.bpmn").write_text(
        process(f'<startEvent id="s"/><scriptTask id="t"><script>{script}</script></scriptTask>{FLOW}')
    )
    scenario.write_text("model: m.bpmn\ncomputers: [P]\n")
    campaign, folder = Campaign(scenario=str(scenario), runs=5, workers=1), Folder(tmp_path / "out")
    folder.begin(campaign)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(campaign, folder)
    assert [(row["run"], row["status"]) for row in folder.rows()] == [(1, "completed"), (2, "completed")]
    rows = run_campaign(campaign, folder)
    assert [(row["run"], row["status"]) for row in rows] == [(number, "completed") for number in range(1, 6)]


def test_it_stops_when_the_interval_is_narrow_enough(scenario: Path, tmp_path: Path) -> None:
    campaign = Campaign(scenario=str(scenario), runs=500, variation=speeds(0.2, 0.8), workers=1)
    rows = rows_of(campaign, tmp_path / "out", width=0.12)
    low, high = interval(rows)
    assert high - low <= 0.12
    assert 20 <= len(rows) < 60


# ---- statistics ------------------------------------------------------------------------------------------------------


def row(number: int, status: str, cause: str = "", duration: float = 1.0, **changes: Any) -> dict[str, Any]:
    return {"run": number, "seed": number, "command": f"fame run {number}", "changes": changes, "status": status,
            "cause": cause, "duration": duration, "collisions": 0, "lost": 0}  # fmt: skip


def test_the_interval_is_wilsons() -> None:
    rows = [row(number, "completed" if number <= 81 else "failed") for number in range(1, 101)]
    assert interval(rows) == pytest.approx((0.722212, 0.874852), abs=1e-5)  # Wilson's formula by hand, z = 1.959964
    assert interval([row(1, "impossible")]) == (0.0, 1.0)
    assert len(counted([*rows, row(101, "crashed")])) == 100


def test_a_crashed_run_is_not_known() -> None:
    rows = [row(1, "completed"), row(2, "completed"), row(3, "crashed"), row(4, "impossible")]
    said = "how 1 of 4 runs end, since they crashed; with them as failures it is 0.667"
    assert summary(rows)["not_known"] == said
    assert f"not known: {said}" in text_report(rows)
    assert f"Not known: {said}." in html_report(rows, "s.yaml")
    assert summary(rows[:2])["not_known"] == ""


def test_what_was_not_measured_is_measured_by_no_comparison() -> None:
    variables = {"P": _Variables({"level": math.nan, "far": 2.0, "none": None})}
    texts = ("P.level", "P.level < 0.2", "not P.level < 0.2", "P.far > 1", "P.none is None")
    assert [_measured(text, variables) for text in texts] == [None, None, None, True, True]


def test_a_measure_without_values_is_said() -> None:
    rows = [row(1, "completed"), row(2, "completed"), row(3, "failed")]
    rows = [
        {**each, "measure.far": value, "measure.near": 1.0} for each, value in zip(rows, (2.0, None, None), strict=True)
    ]
    assert summary(rows)["unmeasured"] == {"far": 1}
    assert "measure far: no value in 1 of 2 completed runs" in text_report(rows)
    assert "measure far: no value in 1 of 2 completed runs" in html_report(rows, "s.yaml")


def test_failures_are_grouped_by_cause_with_the_shortest_run() -> None:
    rows = [row(1, "failed", "a", 9), row(2, "failed", "a", 3), row(3, "timeout", "b", 1), row(4, "completed")]
    assert [(one["cause"], one["count"], one["seed"]) for one in causes(rows)] == [("a", 2, 2), ("b", 1, 3)]


def test_the_parameter_that_matters_comes_first() -> None:
    rows = [
        row(
            n,
            "failed" if n % 10 > 6 else "completed",
            "x",
            float(n % 7),
            speed=n % 10,
            colour="rb"[n // 10 % 2],
            at=[0, n // 20 % 3],
        )
        for n in range(200)
    ]
    found = importance(rows)
    assert found[0]["path"] == "speed"
    assert found[0]["success"] > 0.7
    assert all(one["success"] < 0.2 for one in found[1:])


@pytest.mark.parametrize(
    ("speeds", "statuses"),
    [
        ([1], "c"),
        ([1, 2, 3], "ccc"),
        ([2, 2, 2], "cfc"),
        (["a", "b", "c"], "cfc"),  # each run has a group of its own
    ],
)
def test_the_strength_of_what_says_nothing_is_not_known(speeds: list[Any], statuses: str) -> None:
    rows = [
        row(number, {"c": "completed", "f": "failed"}[status], speed=speed)
        for number, (speed, status) in enumerate(zip(speeds, statuses, strict=True))
    ]
    assert importance(rows) == [{"path": "speed", "success": None, "duration": None}]
    assert "speed: strength not known on success, not known on duration" in text_report(rows)
    assert "strength" in html_report(rows, "s.yaml")


def test_without_a_run_that_has_ended_nothing_is_said_of_completion() -> None:
    rows = [row(1, "impossible"), row(2, "impossible")]
    assert "probability of completion: not known, since no run has ended" in text_report(rows)
    page = html_report(rows, "s.yaml")
    assert "<h1>s.yaml: no run has ended</h1><p>2 runs.</p>" in page
    assert html_report([row(1, "completed")], "s.yaml").count("<use") > page.count("<use")  # the point


@pytest.mark.parametrize(
    ("choices", "column"),
    [
        ([1, "fast"], ["1", "fast"]),
        ([None, 5], ["null", "5"]),
        ([1, 2.5], [1.0, 2.5]),
        ([2**64, 1], [str(2**64), "1"]),
        ([True, 1], ["true", "1"]),
    ],
)
def test_a_column_of_a_table_has_one_type(choices: list[Any], column: list[Any], tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    rows = [row(number, "completed", gear=gear) for number, gear in enumerate(choices)]
    table = write_reports([*rows, row(2, "completed")], tmp_path, "s.yaml", parquet=True)[0]
    assert [*pandas.read_parquet(table)["gear"]][:2] == column


def test_the_page_escapes_what_it_shows() -> None:
    page = html_report([row(1, "failed", "<script>", speed=1), row(2, "completed", speed=2)], "a&b.yaml")
    assert "&lt;script&gt;" in page
    assert "<script>" not in page
    assert "a&amp;b.yaml: 50.0% completed" in page


# ---- the command -----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_command_writes_rows_and_reports(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vary, out = tmp_path / "c.yaml", tmp_path / "out"
    vary.write_text("vary: {variables.P.speed: {uniform: [0.2, 1.2]}}\nmeasure: {far: P.far}\n")
    words = ["campaign", str(scenario), "--runs", "10", "--jobs", "1", "--vary", str(vary), "-o", str(out)]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["runs"] == 10
    assert found["parameters"][0]["path"] == "variables.P.speed"
    lines = (out / "runs.csv").read_text().splitlines()
    assert len(lines) == 11
    assert "variables.P.speed" in lines[0]
    assert "<svg" in (out / "index.html").read_text()
    for plot in ("success", "duration", "parameters"):
        assert ElementTree.parse(out / f"{plot}.svg").getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert main(words) == 2
    assert "has a campaign already; use --resume to continue it" in capsys.readouterr().err
    assert main(["campaign", "--resume", str(out), "--jobs", "1", "--parquet"]) == 0
    assert "probability of completion: " in capsys.readouterr().out
    pandas = pytest.importorskip("pandas")
    assert len(pandas.read_parquet(out / "runs.parquet")) == 10


@pytest.mark.long
def test_a_campaign_that_goes_on_has_the_same_options_and_files(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    begun = ["campaign", str(scenario), "--runs", "2", "--jobs", "1", "-o", str(out)]
    assert main([*begun, "--width", "0.01"]) == 3
    assert "after all runs the interval is 0.658 wide: more than --width 0.01" in capsys.readouterr().err
    for words in (["--runs", "4"], ["--seed", "2"], ["--duration", "1"], ["--record"]):
        assert main(["campaign", "--resume", str(out), *words]) == 2
        assert f"continues a campaign as it began: {words[0]} is for a new one" in capsys.readouterr().err
    assert main(["campaign", "--resume", str(out), "--jobs", "1", "--json"]) == 0
    model = tmp_path / "m.bpmn"
    model.write_text(model.read_text().replace('name="Go"', 'name="Walk"'))
    assert main(["campaign", "--resume", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"m.bpmn: has changed since the campaign in {out} began" in said


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ([], "expected a scenario, or --resume DIR"),
        (["SCENARIO", "--runs", "0"], "expected a whole number from 1 on, got '0'"),
        (["SCENARIO", "--backend", "dask"], "--backend dask needs --address of the scheduler"),
        (["--resume", "nowhere"], "nowhere: has no campaign"),
        (["SCENARIO", "--resume", "nowhere"], "expected a scenario or --resume DIR, got both"),
    ],
)
def test_wrong_requests_are_refused(
    scenario: Path, capsys: pytest.CaptureFixture[str], words: list[str], error: str
) -> None:
    assert main(["campaign", *(str(scenario) if word == "SCENARIO" else word for word in words)]) == 2
    assert error in capsys.readouterr().err


def test_a_varied_key_that_the_scenario_lacks_is_refused_before_the_first_run(scenario: Path) -> None:
    nowhere = Variation((Distribution("world.robots.REX.at", "uniform", (0, 1)),))
    with pytest.raises(ConfigError, match=r"s\.yaml: world\.robots\.REX\.at: the scenario has no world"):
        Campaign(scenario=str(scenario), runs=1, variation=nowhere).check()


def test_the_duration_and_a_measure_of_a_variable_that_is_set_may_be_varied(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(
        process('<startEvent id="s"/><scriptTask id="t"><script>way = [1]</script></scriptTask>' + FLOW)
    )
    (tmp_path / "s.yaml").write_text("model: m.bpmn\nduration: 20\n")
    lasting = (Distribution("duration", "uniform", (5, 10)),)
    begin = partial(Campaign, scenario=str(tmp_path / "s.yaml"), runs=1)
    begin(variation=Variation(lasting, measures={"n": "len(P.way)"})).check()
    with pytest.raises(ConfigError, match=r"nothing sets wya of P; did you mean 'way'\?"):
        begin(variation=Variation(lasting, measures={"n": "len(P.wya)"})).check()
    with pytest.raises(ConfigError, match=r"s\.yaml: P: unknown key"):
        begin(variation=Variation((Distribution("P", "uniform", (5, 10)),))).check()


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("NOBODY@4:engine", "unknown robot 'NOBODY' in --fault; robots are: P"),
        ("P@4", "expected a fault ROBOT@SECOND:KIND, as in Tractor_2@40:engine, got 'P@4'"),
        ("P@4:wing", "wing"),
    ],
)
def test_a_varied_fault_that_no_run_can_have_is_refused_before_the_first_run(
    scenario: Path, fault: str, said: str
) -> None:
    faults = Variation((Distribution(FAULTS, "choice", choices=("none", ["P@4:engine", fault])),))
    with pytest.raises(ConfigError, match=re.escape(said)):
        Campaign(scenario=str(scenario), runs=1, variation=faults).check()


def test_a_run_that_did_not_end_names_who_waits(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(process('<startEvent id="s"/><userTask id="t"/>' + FLOW))
    assert cause_of(Scenario.load(tmp_path / "m.bpmn", duration=1).run()) == "P waited at t"


@pytest.mark.processes
def test_a_cluster_of_dask_does_the_runs(scenario: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        campaign = Campaign(
            scenario=str(scenario),
            runs=6,
            variation=speeds(0.2, 1.2),
            backend="dask",
            address=cluster.scheduler_address,
        )
        rows = rows_of(campaign, tmp_path / "out")
    local = Campaign(scenario=str(scenario), runs=6, variation=speeds(0.2, 1.2), workers=1)
    expected = rows_of(local, tmp_path / "local")
    assert [(one["status"], one["duration"]) for one in rows] == [(one["status"], one["duration"]) for one in expected]


# ---- properties ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_campaign_says_how_often_properties_are_violated_and_how_close_others_came(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario.with_name("m.properties.yaml").write_text(
        "properties:\n  quick: P completes within 2 s\n  rest: after P fails, P completes\n"
    )
    rows = rows_of(Campaign(scenario=str(scenario), runs=12, variation=speeds(0.3, 0.8), workers=1), tmp_path / "out")
    slow = [row for row in rows if row["changes"]["variables.P.speed"] < 0.5]
    assert 0 < len(slow) < 12
    assert [row["property.quick"] for row in rows] == ["violated" if row in slow else "holds" for row in rows]
    quick, rest = summary(rows)["properties"].values()
    assert quick["verdicts"] == {"violated": len(slow), "holds": 12 - len(slow)}
    assert quick["violation"] == pytest.approx(len(slow) / 12, abs=1e-6)
    assert quick["interval"] == pytest.approx(interval(rows, property="quick"), abs=1e-6)
    least = min((row for row in rows if row not in slow), key=lambda row: row["changes"]["variables.P.speed"])
    assert quick["nearest"][0]["command"] == least["command"]
    assert quick["nearest"][0]["slack"] == pytest.approx(2 - 1 / least["changes"]["variables.P.speed"])
    assert (rest["verdicts"], rest["violation"], rest["interval"]) == ({"not triggered": 12}, None, [0.0, 1.0])
    text = "\n".join(text_report(rows))
    assert f"P(violation) {len(slow) / 12:.3f}" in text
    assert f"slack {quick['nearest'][0]['slack']:.3g}: {least['command']}" in text
    assert "quick: P(violation)" in html_report(rows, "s.yaml")
    assert main(["campaign", str(scenario), "--width", "0.1", "--property", "quik", "-o", str(tmp_path / "no")]) == 2
    assert "unknown property 'quik'; did you mean 'quick'?" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


@pytest.mark.long
def test_runs_can_be_recorded(scenario: Path, tmp_path: Path) -> None:
    rows_of(Campaign(scenario=str(scenario), runs=2, workers=1, record=str(tmp_path / "out")), tmp_path / "out")
    with Recording(tmp_path / "out" / "run-2.mcap") as recording:
        assert recording.metadata["seed"] == "2"
        assert {event.element for event in recording.events()} >= {"s", "t"}
    with HeatMap(tmp_path / "out") as heat:
        heat.wait()
        mission = heat.mission()
        (task,) = (str(number) for number, one in enumerate(mission["elements"]) if one["id"] == "t")
        found, runs = mission["heat"]["elements"][task], heat.control({"do": "runs", "element": int(task)})["runs"]
        assert found["times"] == 2
        assert {found["p50"], found["p95"]} == {one["p50"] for one in runs}
        assert [one["name"] for one in runs] == ["run-1.mcap", "run-2.mcap"]


@pytest.mark.long
def test_each_cause_of_failures_has_a_page_of_its_shortest_run(scenario: Path, tmp_path: Path) -> None:
    vary, out = tmp_path / "c.yaml", tmp_path / "out"
    vary.write_text("vary: {variables.P.speed: {choice: [0.5, 1.5]}}\n")
    words = ["campaign", str(scenario), "--runs", "4", "--jobs", "1", "--vary", str(vary), "-o", str(out), "--record"]
    assert main(words) == 0
    report = (out / "index.html").read_text()
    links = re.findall(r'<td>(\d+) <a href="run-(\d+).html">watch</a></td>', report)
    assert len(links) == 1
    (seed, number), page = links[0], (out / f"run-{links[0][1]}.html").read_text()
    assert seed == number  # the first seed is 1
    assert 'id="block/0.json"' in page
    assert [path.name for path in out.glob("run-*.html")] == [f"run-{number}.html"]


@pytest.mark.long
def test_the_page_of_the_same_rows_is_the_same() -> None:
    rows = [
        {
            "run": run,
            "seed": run,
            "status": "completed",
            "duration": 10.0 + run,
            "changes": {"world.x": run},
            "cause": "",
        }
        for run in range(4)
    ]
    assert html_report(rows, "s.yaml") == html_report(rows, "s.yaml")


def test_percentiles_of_a_campaign_are_nearest_ranks() -> None:
    rows = [
        {"run": run, "seed": run, "status": "completed", "duration": float(run), "changes": {}} for run in range(1, 21)
    ]
    spread = summary(rows)["distributions"]["duration"]
    assert {name: spread[name] for name in ("p5", "median", "p95")} == {"p5": 1.0, "median": 10.0, "p95": 19.0}
