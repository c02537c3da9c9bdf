"""Random numbers: one source per robot, the same for the same seed; the modules `random` and `numpy.random` in runs."""

import json
import random
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bpmn_text import process
from deployment_field import Field
from test_resumption import MISSION, Durable

import fame
from fame.campaign.runs import Campaign, Folder, run_campaign
from fame.cli import main
from fame.fleet.engine_log import EngineLog
from fame.log import Recording
from fame.randomness import robot_random
from fame.scenario.run import Run
from fame.testing import MissionLoader

PYTHON = """import random
import numpy
own = [robot.random.random(), robot.random.uniform(1, 2)]
module = [random.random(), random.gauss(0, 1)]
numbers = [float(numpy.random.rand()), float(numpy.random.normal())]
await sleep(1)
later = [random.random(), float(numpy.random.rand())]
if random.random() &lt; 0.5:
    raise BpmnError("bad luck")
"""
JAVASCRIPT = "this.environment.variables.js = [Math.random(), Math.random()]; next()"
DRAWN = ("own", "module", "numbers", "later", "js", "feel")


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    """A robot that draws random numbers in all languages, and fails by chance."""
    feel = """<extensionElements><camunda:inputOutput><camunda:outputParameter name="feel">=[random number(), uuid()]
        </camunda:outputParameter></camunda:inputOutput></extensionElements>"""
    flows = "".join(
        f'<sequenceFlow id="f{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in (("s", "j"), ("j", "k"), ("k", "p"))
    )
    (tmp_path / "m.bpmn").write_text(
        process(
            f'<startEvent id="s"/><scriptTask id="j" scriptFormat="javascript"><script>{JAVASCRIPT}</script>'
            "</scriptTask>"
            f'<scriptTask id="k">{feel}<script>pass</script></scriptTask>'
            f'<scriptTask id="p"><script>{PYTHON}</script></scriptTask>{flows}'
        )
    )
    path = tmp_path / "s.yaml"
    path.write_text("model: m.bpmn\ncomputers: [P]\n")
    return path


def drawn(scenario: Path, seed: int) -> dict[str, Any]:
    """What a run with this seed has drawn."""
    run = Run(fame.Scenario.load(scenario, seed=seed), False, None, None)
    run.result()
    return {name: run.nodes[0].instances[0].variables[name] for name in DRAWN}


def test_the_same_seed_draws_the_same_in_every_language_and_another_seed_something_else(scenario: Path) -> None:
    first, again, other = drawn(scenario, 1), drawn(scenario, 1), drawn(scenario, 2)
    assert first == again
    assert all(first[name] != other[name] for name in DRAWN)


def test_each_robot_has_numbers_of_its_own(scenario: Path) -> None:
    one, other = (
        fame.Simulation(scenario.with_name("m.bpmn"), robot=name).run().instances[0].variables for name in ("A", "B")
    )
    assert all(one[name] != other[name] for name in ("own", "js", "feel"))


def rows(scenario: Path, folder: Path, workers: int = 1) -> list[dict[str, Any]]:
    place = Folder(folder)
    campaign = Campaign(scenario=str(scenario), runs=12, seed=1, workers=workers)
    place.begin(campaign)
    found = sorted(run_campaign(campaign, place), key=lambda row: row["run"])
    return [{key: value for key, value in row.items() if key != "wall"} for row in found]


@pytest.mark.long
def test_two_campaigns_with_the_same_seeds_are_equal_row_by_row(scenario: Path, tmp_path: Path) -> None:
    first = rows(scenario, tmp_path / "one")
    assert {row["status"] for row in first} == {"completed", "failed"}
    random.seed(99)
    assert rows(scenario, tmp_path / "two") == first
    assert rows(scenario, tmp_path / "three", workers=2) == first


@pytest.mark.long
def test_the_printed_command_repeats_each_run(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for row in rows(scenario, tmp_path / "out"):
        main([*shlex.split(row["command"])[1:], "--json"])
        assert json.loads(capsys.readouterr().out)["status"] == row["status"]


def test_a_run_gives_the_modules_back_as_they_were(scenario: Path) -> None:
    before = random.getstate(), np.random.get_state()[1].tolist()
    fame.Scenario.load(scenario, seed=3).run()
    fame.Simulation(scenario.with_name("m.bpmn")).run().close()
    assert (random.getstate(), np.random.get_state()[1].tolist()) == before


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(
    ("task", "draws"),
    [
        ("import random", ["random"]),
        ("x = __import__('numpy')", ["random", "numpy"]),
        ("from importlib import import_module", ["random", "numpy"]),
        ("exec(&quot;im&quot; + &quot;port random&quot;)", ["random", "numpy"]),
        ("", ["random", "numpy"]),
        ("x = robot.random.random()", []),
        ("important = 1  # what others import", []),
        ("import math\nfrom datetime import timedelta", []),
    ],
)
def test_only_what_may_draw_from_the_modules_exchanges_their_states(
    task: str, draws: list[str], encoding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = f"<scriptTask id='a'><script>{task}</script></scriptTask>"
    service = "<serviceTask id='a' camunda:type='external' camunda:topic='draw'/>"
    content = f"<startEvent id='s'/>{script if task else service}<sequenceFlow id='f' sourceRef='s' targetRef='a'/>"
    (tmp_path / "m.bpmn").write_text(process(content), encoding=encoding)
    exchanged = dict[str, bool]()

    def note(name: str, exchange: Callable[[Any], None]) -> Callable[[Any], None]:
        return lambda state: (exchanged.update({name: True}), exchange(state))[1]

    monkeypatch.setattr(random, "setstate", note("random", random.setstate))
    monkeypatch.setattr(np.random, "set_state", note("numpy", np.random.set_state))
    services = {} if task else {"draw": lambda variables: {"x": random.random()}}
    fame.Simulation(tmp_path / "m.bpmn", services=services).run().close()
    assert [*exchanged] == draws


def test_missions_under_test_draw_from_their_seed_and_give_the_modules_back(scenario: Path) -> None:
    before, loader = random.getstate(), MissionLoader(scenario.parent.resolve)
    first, second = (loader.load(scenario, seed=5).advance(0.5).variables() for _ in range(2))
    loader.close()
    assert (first["own"], first["module"]) == (second["own"], second["module"])
    assert random.getstate() == before


@pytest.mark.long
def test_a_loaded_simulation_repeats_nothing_and_is_the_same_each_time(tmp_path: Path) -> None:
    text = "x = robot.random.random()\nawait sleep(5)"
    flows = '<sequenceFlow id="f" sourceRef="s" targetRef="t"/><sequenceFlow id="g" sourceRef="t" targetRef="u"/>'
    path = tmp_path / "m.bpmn"
    path.write_text(
        process(
            f'<startEvent id="s"/><scriptTask id="t"><script>{text}</script></scriptTask>'
            f'<userTask id="v"/><scriptTask id="u"><script>y = robot.random.random()</script></scriptTask>'
            + flows.replace('targetRef="u"', 'targetRef="v"')
            + '<sequenceFlow id="h" sourceRef="v" targetRef="u"/>'
        )
    )
    simulation = fame.Simulation(path).run()
    simulation.save(tmp_path / "state")
    one, other = (fame.Simulation.load(tmp_path / "state").run().complete("v").instances[0].variables for _ in range(2))
    assert one["x"] == simulation.instances[0].variables["x"] != one["y"] == other["y"]


# ---- engines ---------------------------------------------------------------------------------------------------------

DRAWING = MISSION.replace("count = 1", "count = robot.random.random()")


@pytest.mark.long
def test_engines_draw_new_seeds_which_their_recordings_contain_and_a_given_seed_repeats(tmp_path: Path) -> None:
    counts = []
    for number, seed in enumerate([None, None, 7, 7]):
        folder = tmp_path / str(number)
        folder.mkdir()
        field = Field()
        field.listen("A")
        log = EngineLog(folder, "A", field.scheduler, print)
        engine = field.add("A", seed=seed, log=log)
        field.deploy(DRAWING)
        field.pass_time(1)
        counts.append(field.variables("A")["count"])
        engine.close()
        log.close()
        (file,) = folder.glob("*.mcap")
        with Recording(file) as recording:
            recorded = int(recording.metadata["seed"])
        assert recorded == seed or seed is None
        assert counts[-1] == robot_random(recorded, "A").random()
    assert counts[0] != counts[1] != counts[2] == counts[3]


@pytest.mark.long
def test_what_is_deployed_next_and_a_resumed_engine_repeat_no_numbers(tmp_path: Path) -> None:
    field = Durable(tmp_path / "state", seed=7)
    field.deploy(DRAWING)
    first = field.variables("A")["count"]
    field.crash()
    field.start()
    field.pass_time(1)
    assert field.variables("A")["count"] == first  # its script has run, and runs no more
    field.deploy(DRAWING, id="d2", sequence=2)
    second = field.variables("A")["count"]
    field.deploy(DRAWING, id="d3", sequence=3)
    assert len({first, second, field.variables("A")["count"]}) == 3
    field.engine.close()
