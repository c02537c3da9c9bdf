"""Each job is given to one carrier, the lowest bid, also if nobody bids at first (mission.bpmn)."""

from __future__ import annotations

from fame.testing import MissionLoader

MODEL = "../mission.bpmn"


def test_a_job_that_nobody_bids_for_is_offered_again_when_somebody_is_free(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.expect("Dispatcher").completed(within=20)
    assert [offer.value for offer in m.published("/offered")] == ["fetch", "sweep", "carry", "carry"]
    m.expect("Dispatcher").passed("free").before("all given")
    m.advance(20)
    assert sum(len(m.expect(carrier).passed("Work").times) for carrier in ("Carrier_1", "Carrier_2")) == 3


def test_the_lowest_bid_wins(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Carrier": 5})
    m.run_until(published="/awarded")
    bids = {bid.robot: bid.message.vector.x for bid in m.published("/bid")}
    assert len(bids) == 5
    winner = min(bids, key=bids.__getitem__)
    m.advance(0.5)
    m.expect(winner).waits_at("Work")
    for other in bids.keys() - {winner}:
        m.expect(other).never_entered("Work")


def test_the_job_of_a_winner_that_has_died_is_offered_again(mission: MissionLoader) -> None:
    m = mission.load(MODEL, robots={"Carrier": 1})
    m.advance(0.5).fault("Carrier_1", "engine")
    m.advance(30)
    m.expect("Dispatcher").entered("Event_NotAccepted")
    m.expect("Dispatcher").entered("Event_NobodyFree")
    m.expect("Dispatcher").never_entered("given")


def test_a_carrier_without_an_award_does_not_wait_forever(mission: MissionLoader) -> None:
    m = mission.load(MODEL)
    m.run_until("Carrier_1", at="Gateway_Award").fault("Dispatcher", "engine")
    m.advance(4)
    m.expect("Carrier_1").passed("3 s").before("lost")
