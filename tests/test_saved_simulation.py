"""`Simulation.save` and `Simulation.load`: the run goes on as if it had not been interrupted."""

from pathlib import Path

import pytest
from bpmn_text import document

import fame
from fame.errors import ConfigError
from fame.robot import Event

MODEL = document(
    '<process id="p" isExecutable="true"><startEvent id="s"/>'
    '<scriptTask id="a"><script>items = [1, {"k": (2, 3)}]</script>'
    '</scriptTask><intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT60S</timeDuration>'
    '</timerEventDefinition></intermediateCatchEvent><scriptTask id="b"><script>items.append(2)</script></scriptTask>'
    '<userTask id="u"/><endEvent id="e"/>'
    + "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ["sa", "ac", "cb", "bu", "ue"])
    + "</process>"
)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.bpmn"
    path.write_text(MODEL)
    return path


def test_it_goes_on_at_the_time_and_with_the_state_of_then(model: Path, tmp_path: Path) -> None:
    sim = fame.Simulation(model).run(20)
    sim.save(tmp_path / "run.state")
    again = fame.Simulation.load(tmp_path / "run.state")
    assert again.now == 20
    again.run(59)
    assert again.instances[0].waiting == ["c"]
    again.run(61)
    assert again.instances[0].waiting == ["u"]
    again.complete("u")
    assert again.instances[0].status == "completed"
    assert again.instances[0].variables == {"items": [1, {"k": (2, 3)}, 2]}
    assert again.instances[0].visits == {"s": 1, "a": 1, "c": 1, "b": 1, "u": 1, "e": 1}


def test_instances_that_are_over_are_there_as_well(model: Path, tmp_path: Path) -> None:
    sim = fame.Simulation(model).run().complete("u")
    sim.start()
    sim.run()
    sim.save(tmp_path / "run.state")
    again = fame.Simulation.load(tmp_path / "run.state").run()
    assert [instance.status for instance in again.instances] == ["completed", "running"]
    assert again.complete("u").instances[1].variables == again.instances[0].variables


def test_an_observer_gets_what_happens_from_then_on(model: Path, tmp_path: Path) -> None:
    fame.Simulation(model, observer=fame.EventLog()).run().save(tmp_path / "run.state")
    events: list[Event] = []
    fame.Simulation.load(tmp_path / "run.state", observer=events.append).complete("u")
    assert [event.element for event in events if event.what == "enter"] == ["e"]


def test_the_state_of_another_model_is_refused(model: Path, tmp_path: Path) -> None:
    fame.Simulation(model).run().save(tmp_path / "run.state")
    model.write_text(MODEL.replace("append(2)", "append(3)"))
    with pytest.raises(ConfigError, match=r"run\.state: the state is one of program"):
        fame.Simulation.load(tmp_path / "run.state")


@pytest.mark.parametrize("content", [b"", b"x", b"\n\n"])
def test_what_is_no_saved_simulation_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "run.state").write_bytes(content)
    with pytest.raises(ConfigError, match="is not a journal of a FAME engine"):
        fame.Simulation.load(tmp_path / "run.state")


def test_a_variable_that_cannot_be_stored_is_named(model: Path, tmp_path: Path) -> None:
    text = "class Thing: pass\nitems = [Thing()]"
    model.write_text(MODEL.replace('items = [1, {"k": (2, 3)}]', text))
    with pytest.raises(ConfigError, match=r"the state cannot be stored: variable (items|Thing): "):
        fame.Simulation(model).run(1).save(tmp_path / "run.state")


def test_a_file_that_cannot_be_written_is_said(model: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory"):
        fame.Simulation(model).run(1).save(tmp_path / "no" / "run.state")
