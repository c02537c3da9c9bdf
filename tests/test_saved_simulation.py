"""`Simulation.save` and `Simulation.load`: the run goes on as if it had not been interrupted."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document

import fame
from fame.engine import compiler
from fame.engine.program import Program
from fame.errors import ConfigError
from fame.robot import Event, restoring
from fame.robot.host import EngineHost
from fame.robot.mission import Mission

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


def test_a_robot_on_hold_stays_so_until_it_is_released(model: Path, tmp_path: Path) -> None:
    sim = fame.Simulation(model).run(20)
    sim.node.hold()
    sim.node.hold("inspection")
    sim.save(tmp_path / "run.state")
    again = fame.Simulation.load(tmp_path / "run.state").run(70)
    again.node.release()
    assert again.run(80).instances[0].waiting == ["c"]
    again.node.release("inspection")
    assert again.run(90).instances[0].waiting == ["u"]


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
    with pytest.raises(ConfigError, match=r"run\.state: the state is one of another model"):
        fame.Simulation.load(tmp_path / "run.state")


# ---- of another FAME, whose compiler makes something else of the same text -------------------------------------------


class Other:
    """A compiler that gives nodes other keys, counts elements in another order, and reads a model otherwise."""

    def __init__(self, patch: pytest.MonkeyPatch, **keys: str) -> None:
        self._patch, self._keys = patch, keys

    def save(self, model: Path, until: float, path: Path, *, old: bool = False) -> None:
        """Run a model and save its state; with `old` as FAME 0.2 did."""

        def rename(nodes: Any, make_unique: Any = compiler._make_keys_unique) -> None:
            make_unique(nodes)
            for node in nodes:
                node.key = self._keys.get(node.key, node.key)

        with self._patch.context() as patch:
            patch.setattr(compiler, "_make_keys_unique", rename)
            patch.setattr(Program, "made", "read otherwise")
            if old:
                patch.setattr(Mission, "hash", lambda self: "")
                patch.setattr(restoring, "description", lambda program: {"program": program.hash})
            simulation = fame.Simulation(replace(fame.read(model)))  # not compiled before
            order = [0, *reversed(range(1, len(simulation.node.engine.program.elements)))]
            simulation.run(until)
            if not old:
                program, counts = simulation.node.engine.program, simulation.instances[0].counts
                program.elements[:] = [program.elements[slot] for slot in order]
                counts[:] = [counts[slot] for slot in order]
            simulation.save(path)


def loaded(path: Path) -> tuple[fame.Simulation, list[str]]:
    """A simulation that goes on, and what was reported when it was loaded."""
    reports: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EngineHost, "report", lambda self, element, text: reports.append(text))
        return fame.Simulation.load(path), reports


def test_a_state_goes_over_by_elements_to_what_another_fame_makes_of_the_same_text(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Other(monkeypatch, c="c/wait", a="a/run").save(model, 20, tmp_path / "run.state")
    again, reports = loaded(tmp_path / "run.state")
    assert reports == ["this FAME makes something else of the model, to which the state goes over: c/wait as c"]
    assert again.instances[0].visits == {"s": 1, "a": 1}
    again.run(59)
    assert again.instances[0].waiting == ["c"]
    assert again.run(61).complete("u").instances[0].visits == {"s": 1, "a": 1, "c": 1, "b": 1, "u": 1, "e": 1}


def test_what_has_no_place_any_more_is_named(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    each = "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"
    model.write_text(MODEL.replace('<userTask id="u"/>', f'<userTask id="u">{each}</userTask>'))
    Other(monkeypatch, **{"u/loop": "u/outer", "u": "u/inner"}).save(model, 70, tmp_path / "run.state")
    text = (
        r"run\.state: this FAME makes something else of u, where the state has a token, an event or a message; end that"
    )
    with pytest.raises(ConfigError, match=text):
        fame.Simulation.load(tmp_path / "run.state")


def test_of_an_old_state_it_is_not_known_whether_it_is_of_this_text(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Other(monkeypatch).save(model, 20, tmp_path / "run.state", old=True)
    again, reports = loaded(tmp_path / "run.state")
    assert reports == ["it is not known whether the state was saved with this text of the model"]
    assert again.run(61).instances[0].waiting == ["u"]


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
