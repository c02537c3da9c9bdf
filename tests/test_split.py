"""Collaborations are split into one file per pool, and robots are assigned to pools."""

from pathlib import Path

import pytest

import fame
from fame.bpmn.library import Library
from fame.bpmn.pools import assign_pools, pools_of
from fame.bpmn.reader import read_bytes, read_text
from fame.bpmn.split import split
from fame.cli import main

MISSION = "models/ground_vehicles.bpmn"


def collaboration(*pools: str) -> fame.bpmn.model.Definitions:
    participants = "".join(
        f'<participant id="P{n}" {pool} processRef="p{n}"/>' if "name" in pool else f'<participant id="P{n}" {pool}/>'
        for n, pool in enumerate(pools)
    )
    processes = "".join(f'<process id="p{n}"><startEvent id="s{n}"/></process>' for n, _ in enumerate(pools))
    return read_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t">'
        f'<collaboration id="c">{participants}</collaboration>{processes}</definitions>',
        file="team.bpmn",
    )


@pytest.fixture
def parts():
    return split(fame.read(MISSION))


def test_each_pool_becomes_a_file_of_its_own(parts):
    assert [part.filename for part in parts] == ["REX.bpmn", "DINGO.bpmn"]


def test_a_part_holds_all_that_it_calls_and_nothing_of_the_others(parts):
    rex = read_bytes(parts[0].source, file="REX.bpmn")
    assert [pool.name for pool in rex.participants] == ["REX"]
    nowhere = Library()
    nowhere.path = lambda file: iter(())  # type: ignore[method-assign]
    called = {process.name or process.id for _, process in nowhere.closure(rex, rex.processes[0])}
    assert len(called) >= 5
    dingo = read_bytes(parts[1].source)
    assert "Explore" not in {process.id for process in dingo.processes}


def test_a_part_runs_like_the_pool_it_was(parts):
    dingo = read_bytes(parts[1].source, file="DINGO.bpmn")
    simulation = fame.Simulation(dingo, "DINGO", robot="DINGO").run()
    assert simulation.instances == []
    simulation.signal("target_found", {"x": 1.0, "y": 2.0})
    (instance,) = simulation.instances
    assert (instance.variables["x_target"], instance.variables["y_target"]) == (1.0, 2.0)


def test_types_said_in_one_pool_are_written_into_the_others(parts):
    from fame.bpmn.topics import topic_table

    for part in parts:
        assert topic_table(read_bytes(part.source))["/done"].declared == "std_msgs/msg/Bool"


def test_pools_are_bound_to_robots_without_regard_to_case():
    pools = pools_of(collaboration('name="Drone"'))
    assert {robot: pool.name for robot, pool in assign_pools(pools, ["drone"]).items()} == {"drone": "Drone"}


def test_a_multi_instance_pool_is_every_robot_with_its_name_and_a_number():
    definitions = read_text(
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"><collaboration id="c">'
        '<participant id="P" name="Tractor" processRef="p"><participantMultiplicity minimum="1" maximum="9"/>'
        '</participant></collaboration><process id="p"><startEvent id="s"/></process></definitions>'
    )
    pools = pools_of(definitions)
    assert list(assign_pools(pools, ["Tractor_2", "tractor_10"])) == ["Tractor_2", "tractor_10"]
    with pytest.raises(fame.ConfigError, match="Tractor_<number>"):
        assign_pools(pools, ["Tractor_x"])
    assert assign_pools(pools, []) == {}


def test_a_robot_that_no_pool_knows_is_named_with_the_pools_there_are():
    with pytest.raises(fame.ConfigError, match=r"robot 'Bob'.*A, B"):
        assign_pools(pools_of(collaboration('name="A"', 'name="B"')), ["A", "B", "Bob"])


def test_names_that_fall_together_are_refused():
    with pytest.raises(fame.ModelError, match="two pools have the name 'rex'"):
        pools_of(collaboration('name="REX"', 'name="rex"'))
    with pytest.raises(fame.ConfigError, match="case only"):
        assign_pools(pools_of(collaboration('name="REX"')), ["REX", "rex"])


def test_a_pool_whose_name_no_robot_can_have_is_named():
    with pytest.raises(fame.ModelError, match=r"pool 'Go To' cannot name a robot: expected letters, digits and _"):
        assign_pools(pools_of(collaboration('name="Go To"')), [])


def test_no_pool_is_written_over_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "team.bpmn"
    model.write_bytes(collaboration('name="A_B"', 'name="A B"').source)
    assert main(["split", str(model), "-o", str(tmp_path / "out")]) == 2
    assert "pools 'A_B' and 'A B' would be written to one file, A_B.bpmn: rename one" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_black_box_alone_leaves_nothing_to_run():
    with pytest.raises(fame.ModelError, match=r"black boxes: P0"):
        pools_of(collaboration(""))
