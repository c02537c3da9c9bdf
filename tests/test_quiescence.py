"""A team has ended when all its robots have said so, not when the last reports that came do not say otherwise."""

from fame.scenario.quiescence import QuiescenceDetector


def test_a_robot_that_is_not_heard_confirms_nothing():
    detector = QuiescenceDetector(5)
    assert not detector.look({"A": 10, "B": 8}, 3, 10)
    assert not detector.look({"A": 90, "B": 8}, 3, 90)
    assert not detector.look({"A": 90, "B": 91}, 3, 91)  # what it says may be older than a message on its way
    assert not detector.look({"A": 90, "B": 91}, 3, 99)
    assert detector.look({"A": 90, "B": 96}, 3, 99)


def test_what_is_done_meanwhile_begins_it_anew():
    detector = QuiescenceDetector(5)
    detector.look({"A": 10, "B": 10}, 3, 10)
    assert not detector.look({"A": 15, "B": 15}, 4, 15)  # B has done something, which A may not know yet
    assert not detector.look({"A": 16, "B": 20}, 4, 20)
    assert detector.look({"A": 21, "B": 21}, 4, 21)


def test_nothing_is_confirmed_while_something_runs():
    detector = QuiescenceDetector(5)
    detector.look({"A": 10}, 3, 10)
    assert not detector.look({"A": 15}, None, 15)
    assert not detector.look({"A": 20}, 3, 20)
    assert detector.look({"A": 25}, 3, 25)


def test_a_robot_that_has_been_given_up_is_not_waited_for():
    detector = QuiescenceDetector(5)
    detector.look({"A": 10, "B": 8}, 3, 10)
    assert not detector.look({"A": 15, "B": 8}, 3, 15)
    assert detector.look({"A": 16}, 3, 16)
