"""A part leaves only with an approval: of the operator, else of the supervisor (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_the_operator_approves(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.advance(30).complete("Approve", approved=True)
    m.expect().completed(within=10).passed("Deliver")
    m.expect().never_entered("Decide")


def test_the_supervisor_rejects(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.run_until(at="Decide")
    assert m.now == 65
    m.complete("Decide", approved=False)
    m.expect().completed(within=10).passed("Scrap")
    m.expect().never_entered("Deliver")


def test_without_an_answer_nothing_leaves(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect().completed(within=185).never_entered("Deliver")
    assert len(m.published("/set_aside")) == 1
