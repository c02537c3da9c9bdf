"""Missions that go on step by step, as a test says."""

from pathlib import Path

import pytest
from collaborations import text_of

from fame.errors import ConfigError
from fame.testing import ExpectationError, MissionLoader


@pytest.fixture
def handshake(tmp_path: Path) -> Path:
    path = tmp_path / "handshake.bpmn"
    path.write_text(text_of({"A": ["work", "throw go", "catch done"], "B": ["catch go", "fail lame", "throw done"]}))
    return path


def test_nothing_ends_or_arrives_by_itself(handshake: Path, mission: MissionLoader) -> None:
    m = mission.by_hand(handshake)
    m.advance(100).expect("A").waits_at("work")
    m.finish("A", "work").expect("B").waits_at("go")
    m.arrive("B", "/go").expect("B").waits_at("work")
    m.finish("B", "work").arrive("A", "done")
    m.expect("A").completed()
    m.expect("B").completed()


def test_what_is_left_goes_on_if_somebody_waits_for_it(handshake: Path, mission: MissionLoader) -> None:
    m = mission.by_hand(handshake)
    m.expect("A").completed(within=60)
    m.expect("A").passed("work").before("done")


def test_a_lost_message(handshake: Path, mission: MissionLoader) -> None:
    m = mission.by_hand(handshake)
    m.finish("A", "work").lose("B", "go")
    with pytest.raises(ExpectationError, match="A: expected to have completed within 60 s"):
        m.expect("A").completed(within=60)
    m.expect("B").waits_at("go")


def test_a_step_that_fails(handshake: Path, mission: MissionLoader) -> None:
    m = mission.by_hand(handshake)
    m.finish("A", "work").arrive("B", "go").finish("B", "work", raises="lame")
    m.expect("B").failed("lame", at="work")


def test_a_step_that_never_ends(handshake: Path, mission: MissionLoader) -> None:
    m = mission.by_hand(handshake).block("A", "work")
    with pytest.raises(ExpectationError):
        m.expect("A").completed(within=60)


def test_a_step_that_is_not_possible_shows_the_state(handshake: Path, mission: MissionLoader) -> None:
    m = mission.by_hand(handshake)
    with pytest.raises(ExpectationError, match=r"B: expected to be at 'work', so that it ends(.|\n)*A  at \"work\""):
        m.finish("B", "work")
    with pytest.raises(ExpectationError, match="B: expected a message on /go on its way to it"):
        m.arrive("B", "go")
    with pytest.raises(ConfigError, match="B has no element 'wrok'; did you mean \"work\""):
        m.finish("B", "wrok")


def test_timers_people_and_decisions(tmp_path: Path, mission: MissionLoader) -> None:
    path = tmp_path / "model.bpmn"
    path.write_text(text_of({"A": ["timer PT1H", "person", ("or", ["throw left"], ["throw right"])], "B": [
        ("race", ["catch left"], ["catch right"])]}))  # fmt: skip
    m = mission.by_hand(path)
    m.decide("A", next(id for id in ids(m) if id.startswith("A_split")), False)
    m.advance(7200).expect("A").waits_at("PT1H")
    m.fire("A", "PT1H").complete("A", "person")
    m.expect("A").completed()
    m.arrive("B", "right").expect("B").completed()


def ids(m: object) -> list[str]:
    return [node.id for process in m.scenario.definitions.processes for node in process.body.nodes]  # type: ignore[attr-defined]


def test_a_scenario_has_no_world_by_hand(mission: MissionLoader) -> None:
    m = mission.by_hand("examples/ground_vehicles.yaml")
    m.signal("REX", "~/odom").expect("DINGO").never_entered("Go To")
    assert m.world is None
