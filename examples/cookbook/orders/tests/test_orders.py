"""Answers come in any order, and each to the order that it is for (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

ORDERS = ["apples", "pears", "plums"]


def test_each_order_takes_its_own_answer(mission: MissionLoader) -> None:
    m = mission.load("../mission.bpmn", seed=1)
    m.expect("DEPOT").completed(within=10).has(shelf=ORDERS)
    answers = [answer.message.key for answer in m.published("/picked")]
    assert sorted(answers) == ORDERS != answers
