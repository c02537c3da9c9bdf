"""The follower visits the places of the leader in their order, also if it is slower (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

ROUTE = [(0, 0), (3, 0), (3, 2), (0, 2)]


def test_the_slow_follower_visits_all_places_in_their_order(mission: MissionLoader) -> None:
    m = mission.load("../mission.bpmn")
    visited: list[tuple[float, float]] = []
    while not visited or visited[-1] != ROUTE[-1]:
        m.run_until("FOLLOWER", at="Drive There").advance(1)
        variables = m.variables("FOLLOWER")
        if (place := (variables["x_goal"], variables["y_goal"])) not in visited:
            visited.append(place)
    assert visited == ROUTE
    m.expect("LEADER").completed()
    m.expect("FOLLOWER").completed(within=5).passed("Drive There", times=4)
