"""Explorations of collaborations whose verdicts are known."""

import re
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import process
from check_drawing import catch, row, script, team as drawn, throw
from collaborations import Steps, philosophers, team, text_of

import fame
from fame.check.explore import Exploration
from fame.errors import ConfigError
from fame.properties import parse
from fame.scenario.explore.exploration import explore


def found(steps: dict[str, Steps], *, several: tuple[str, ...] = (), **options: Any) -> Exploration:
    """Explore a collaboration."""
    return explore(team(steps, several), **options)


def kinds(result: Exploration) -> set[str]:
    return {one.kind for one in result.findings if one.kind != "unneeded"}


def test_a_signal_and_its_answer_have_no_problem() -> None:
    result = found({"A": ["work", "throw ask", "catch answer"], "B": ["catch ask", "work", "throw answer"]})
    assert result.exhaustive
    assert not kinds(result)


def test_two_robots_that_wait_for_each_other_are_a_deadlock() -> None:
    result = found({"A": ["catch b", "throw a"], "B": ["catch a", "throw b"]})
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert "A waits at" in one.text
    assert "for /b" in one.text
    assert "B waits at" in one.text
    assert one.doomed == 0 or not one.run
    assert result.failed


def test_a_signal_thrown_before_its_catcher_waits_is_lost() -> None:
    result = found({"A": ["throw go", "catch done"], "B": ["work", "catch go", "throw done"]}, delivery="run")
    (one,) = (one for one in result.findings if one.kind == "lost")
    assert "/go was lost on a robot that needed it" in one.text
    assert any(step.kind == "miss" and step.detail == "/go" for step in one.run)


def test_what_robots_throw_at_their_start_arrives_before_all_that_follows_from_it() -> None:
    """C's signal is on its way before B answers A's: A takes it, and waits in vain for a second one, as in a run."""
    robots = {"A": ["throw a", ("race", ["catch b"], ["catch c", "catch a"])], "B": ["catch a", "throw b"],
              "C": ["throw c"]}  # fmt: skip
    result = found(robots, delivery="run", properties=[parse("never A completes A_catch_c_8")])
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert [place.element for place in one.places] == ["A_catch_a_10"]
    assert [judged.verdict for judged in result.properties] == ["refuted"]


def test_what_a_step_throws_many_times_is_told_once() -> None:
    result = found({"A": ["work", ("beside", ["throw a", "work"], "a", ["throw a"])]}, delivery="run")
    (text,) = (one.run[-1].text for one in result.findings if one.kind == "error")
    assert re.search(r"throws /a, \d+,\d{3} times; ", text)
    assert len(text) < 200


def test_a_queue_removes_the_loss() -> None:
    """The queue is open from the start of the process, before any delivery."""
    result = found({"A": ["throw go", "catch done"], "B": ["work", "queue go", "throw done"]})
    assert not kinds(result)


@pytest.mark.parametrize("count", [2, 3])
def test_dining_philosophers_block_each_other(count: int) -> None:
    result = found(philosophers(count, ordered=False), delivery="run")
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert all(f"Phil{n} waits at" in one.text for n in range(count))


@pytest.mark.parametrize("count", [2, 3])
def test_dining_philosophers_who_take_forks_in_one_order_do_not(count: int) -> None:
    result = found(philosophers(count, ordered=True), delivery="run")
    assert result.exhaustive
    assert not result.failed


@pytest.mark.parametrize("count", [3, 5])
def test_a_ring_in_which_somebody_begins_goes_round(count: int) -> None:
    robots: dict[str, Steps] = {"R0": ["work", "throw s0", f"catch s{count - 1}"]}
    robots |= {f"R{n}": [f"catch s{n - 1}", f"throw s{n}"] for n in range(1, count)}
    assert not kinds(found(robots))
    robots["R0"] = [f"catch s{count - 1}", "throw s0"]
    assert "deadlock" in kinds(found(robots))


def test_a_race_of_two_signals_that_only_one_answers() -> None:
    robots: dict[str, Steps] = {
        "Judge": [("race", ["catch red", "throw stop"], ["catch blue", "throw go"]), "catch seen"],
        "Red": ["work", "throw red"],
        "Blue": ["work", "throw blue"],
        "Watch": ["catch go", "throw seen"],
    }
    result = found(robots)
    assert "deadlock" in kinds(result)
    (one,) = (one for one in result.findings if one.kind in ("deadlock", "lost"))
    assert "Watch waits at" in one.text
    assert any("Red" in str(step) for step in one.run)


def test_timers_that_race() -> None:
    """Nothing says that 10 s are over before 30 s have passed, unless timers are ordered."""
    late: Steps = [("and", ["timer PT10S", "run armed = 1", "throw x"], ["timer PT30S", "catch y"])]
    robots: dict[str, Steps] = {"A": late, "B": ["catch x", "throw y"]}
    assert "lost" in kinds(found(robots, timers="any"))
    assert "lost" in kinds(found(robots, timers="ordered")), "/y comes at once, after 10 s"
    early: Steps = [("and", ["timer PT30S", "throw x"], ["timer PT10S", "catch y"])]
    robots = {"A": early, "B": ["catch x", "throw y"]}
    assert "lost" in kinds(found(robots, timers="any"))
    assert not kinds(found(robots, timers="ordered"))


def test_a_mission_without_an_end_never_completes() -> None:
    result = found({"A": [("while", ["work"])]})
    (one,) = (one for one in result.findings if one.kind == "never")
    assert one.text.startswith("no run completes")


def test_the_step_after_which_completion_is_impossible() -> None:
    robots: dict[str, Steps] = {"A": ["work", ("or", ["throw x"], ["work", "work"]), "end"], "B": ["catch x"]}
    result = found(robots, delivery="run")
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert one.doomed == 0, "the decision is taken as the first step ends"
    assert len(one.run) == 3


def test_values_are_computed() -> None:
    robots: dict[str, Steps] = {
        "A": ["run n = 0", "work", "run n = n + 1", ("if", "n == 1", ["throw x"], ["work"])],
        "B": ["catch x"],
    }
    result = found(robots)
    assert not result.failed
    (other,) = (one for one in result.findings if one.kind == "unreachable")
    assert len(other.places) == 2, "the other branch is never taken"


def test_an_error_that_nobody_catches_is_one_finding_per_element() -> None:
    result = found({"A": [("and", ["work"], ["work"]), "fail broken"]})
    (one,) = (one for one in result.findings if one.kind == "error")
    assert "error broken not caught" in one.text
    assert not result.failed


# ---- errors that nothing catches -------------------------------------------------------------------------------------


RAISE = "run raise BpmnError('broken')"


@pytest.mark.parametrize("delivery", ["run", "fast", "any"])
def test_an_uncaught_error_ends_its_instance_and_the_others_go_on(delivery: str) -> None:
    """Two of them block each other, whatever the third one does."""
    blocked: dict[str, Steps] = {"A": ["work", "catch b", "throw a"], "B": ["work", "catch a", "throw b"]}
    result = found({**blocked, "C": ["work", RAISE]}, delivery=delivery)
    assert result.exhaustive
    (one,) = (one for one in result.findings if one.level == "error")
    assert one.kind == "error"
    assert "error broken was not caught" in " ".join(map(str, one.run))
    assert "then A waits at" in one.text
    assert one.robots == ("A", "B")
    never = [place.element for one in result.findings if one.kind == "unreachable" for place in one.places]
    assert never
    assert not any("work" in element for element in never)
    result = found({**blocked, "C": ["work", "fail broken"]}, delivery=delivery)
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert "then" not in next(one.text for one in result.findings if one.kind == "error"), "that is so without it, too"


def test_what_waits_forever_after_an_error_is_told_with_it_once() -> None:
    robots: dict[str, Steps] = {"A": ["fail lame", "fail late", "throw done"], "B": ["catch done"], "C": ["fail other"]}
    result = found(robots)
    errors = {one.places[0].element: one for one in result.findings}
    assert [one.kind for one in errors.values()] == ["error"] * 3
    assert {bool(one.robots) for one in errors.values() if "A_" in one.places[0].element} == {True}
    assert not next(one for element, one in errors.items() if "C_" in element).robots
    assert not result.failed
    told = next(one for one in errors.values() if "late" in one.text)
    assert told.text.endswith(", forever")
    assert told.doomed is not None
    assert str(told.run[told.doomed]) == 'A\'s "work" fails: late'
    assert sum(step.kind == "fail" for step in told.run) == 1


def test_an_error_that_waits_on_two_errors_is_told_at_one() -> None:
    """B waits if both are lame; nobody waits if one of them is."""
    robots: dict[str, Steps] = {"A": ["fail lame", "throw a"], "C": ["fail lame", "throw c"],
                                "B": [("race", ["catch a"], ["catch c"])]}  # fmt: skip
    told = [one for one in found(robots, delivery="run").findings if one.kind == "error" and one.robots]
    assert told
    assert all(sum(step.kind == "fail" for step in one.run) == 2 for one in told)


def test_an_error_fails_the_check_if_it_is_computed_or_no_run_completes() -> None:
    for steps in (["work", RAISE], [RAISE], ["run n = []", ("if", "n[0] == 1", ["work"], [])]):
        result = found({"A": steps, "B": ["work"]})
        assert result.failed, steps
        assert [one.kind for one in result.findings if one.level == "error"] == ["error"]
        assert not any(place.element.startswith("B") for one in result.findings for place in one.places)
    one_way = "run if x > 1: raise BpmnError('a')"
    assert not found({"A": ["run x = robot.now", one_way]}).failed
    assert found({"A": ["run x = robot.now", f"{one_way}\nraise BpmnError('b')"]}).failed
    assert not found({"A": ["run seen = {1: 2}", "run x = seen[robot.now]"]}).failed  # the key may be there


def test_a_loop_that_only_an_error_ends_never_completes() -> None:
    result = found({"A": [("while", ["fail broken"])]})
    assert {"never", "error"} == kinds(result)
    assert next(one for one in result.findings if one.kind == "never").text.startswith("no run completes")
    counted: Steps = ["run n = 0", ("while", ["work", "run n += 1\nif n > 2: raise BpmnError('broken')"])]
    result = found({"A": counted, "B": ["work"]})
    assert [one.kind for one in result.findings if one.level == "error"] == ["error"]


def test_an_error_of_one_delivery_fails_the_check_in_both() -> None:
    """A message that comes early makes it certain."""
    robots: dict[str, Steps] = {"A": [("race", ["catch a", RAISE], ["catch b"])], "B": ["throw b"], "C": ["throw a"]}
    assert found(robots, delivery="fast").failed
    assert found(robots).failed


def test_multi_instance_bidding() -> None:
    """The auctioneer takes the first bid; the others have nobody to tell them that it is over."""
    robots: dict[str, Steps] = {
        "Seller": ["work", "throw call", "catch bid", "throw sold"],
        "Bidder": ["catch call", "work", "throw bid", "catch sold"],
    }
    result = found(robots, several=("Bidder",), robots={"Bidder": 3})
    assert "lost" in kinds(result)
    assert any("Bidder_" in one.text for one in result.findings if one.kind == "lost")


def test_an_event_sub_process_that_arms_too_late() -> None:
    """It listens once its scope is entered, which is after some work."""
    late: Steps = ["work", ("scope", ["work"], "alarm", ["throw ack"])]
    result = found({"A": late, "B": ["throw alarm", "catch ack"]}, delivery="run")
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert "B waits at" in one.text
    assert any(step.kind == "miss" and step.detail == "/alarm" for step in one.run)
    in_time: Steps = [("scope", ["throw ready", "work"], "alarm", ["throw ack"])]
    assert not found({"A": in_time, "B": ["catch ready", "throw alarm", "catch ack"]}, delivery="run").failed


def test_two_triggers_start_two_instances() -> None:
    robots: dict[str, Steps] = {"A": ["throw go", "work", "throw go"], "B": ["start go", "work"]}
    assert not kinds(found(robots))


def test_an_element_that_no_token_enters() -> None:
    result = found({"A": ["run n = 1", ("if", "n == 2", ["person"], ["work"])]})
    (one,) = (one for one in result.findings if one.kind == "unreachable")
    assert any("person" in place.element for place in one.places)


def test_growth_without_bound_is_reported_and_not_exhaustive() -> None:
    result = found({"A": [("while", ["work", "throw go"])], "B": ["start go", "person"]}, delivery="run")
    assert "growth" in kinds(result)
    assert not result.exhaustive
    assert "NOT all states explored" in result.summary()


def test_a_limit_is_said_first() -> None:
    result = found(philosophers(3, ordered=False), limit=50)
    assert not result.exhaustive
    assert "the limit of 50 states is reached" in result.summary()


EITHER: Steps = ["run n = n + 1", ("or", ["run m = n"], ["run m = 2"]), ("or", ["run m = n"], ["run m = 2"])]
SLOW = "run n = n + len([i for i in range(4000) if n])"


@pytest.mark.long_but("*bound1")
@pytest.mark.parametrize(("body", "bound"), [(EITHER, {}), ([SLOW], {"seconds": 0.2})])
def test_a_loop_in_no_time_ends_by_the_bounds_of_the_search(body: Steps, bound: dict[str, Any]) -> None:
    result = found({"A": ["run n = 1", ("while", [*body, ("if", "n == 1", ["work"], [])])]}, delivery="run", **bound)
    assert not result.exhaustive
    assert result.states <= 1


def test_progress_is_told_as_states_are_found() -> None:
    told: list[tuple[int, int]] = []
    found(
        philosophers(3, ordered=False),
        delivery="fast",
        progress=lambda states, frontier: told.append((states, frontier)),
    )
    assert told[0] == (1, 1)
    assert all(0 < frontier <= states for states, frontier in told)
    assert max(told)[0] > 256


def test_a_variable_that_counts_for_ever_becomes_unknown() -> None:
    result = found({"A": ["run n = 0", ("loop", ["work", "run n = n + 1"]), ("if", "n == 500", ["work"], ["person"])]})
    assert result.exhaustive
    assert result.widened == (("A", "n"),)
    assert not kinds(result), "500 is one of its values"


def test_an_accepted_deadlock_does_not_fail() -> None:
    robots: dict[str, Steps] = {"A": ["catch b", "throw a"], "B": ["catch a", "throw b"]}
    result = explore(team(robots, accept=dict.fromkeys("AB", "deadlock: they are started by hand")))
    (one,) = (one for one in result.findings if one.kind == "deadlock")
    assert one.accepted == "they are started by hand"
    assert not result.failed


def test_a_deadlock_is_accepted_only_for_every_robot_that_waits() -> None:
    robots: dict[str, Steps] = {"A": ["catch b", "throw a"], "B": ["catch a", "throw b"]}
    result = explore(team(robots, accept={"A": "deadlock: somebody ends it"}))
    assert result.failed
    patrol: dict[str, Steps] = {"A": [("while", ["work"])], "B": [("or", ["work"], [("while", ["work"])])]}
    result = explore(team(patrol, accept={"A": "never: patrols until it is stopped"}))
    assert [bool(one.accepted) for one in result.findings if one.kind == "never"] == [True, False]


def test_an_accepted_deadlock_hides_none_that_contains_it() -> None:
    robots: dict[str, Steps] = {"A": ["catch stop"], "B": [("or", ["work"], ["catch never"])], "C": ["person"]}
    robots["D"] = [("or", ["throw x"], ["throw stop", "throw never"])]
    result = explore(team(robots, accept={"A": "deadlock: somebody ends it; lost: somebody ends it"}), delivery="run")
    stuck = {one.robots: bool(one.accepted) for one in result.findings if one.kind in ("deadlock", "lost")}
    assert stuck[("A",)] is True
    assert stuck[("A", "B")] is False
    assert result.failed


def test_an_accepted_loss_hides_no_deadlock_at_the_same_elements() -> None:
    """B misses what A throws early; or A throws nothing."""
    robots: dict[str, Steps] = {"A": [("or", ["throw go"], ["work"])], "B": ["timer PT5S", "catch go"]}
    loss = "lost: somebody throws it again"
    result = explore(team(robots, accept={"B": loss}))
    assert [one.robots for one in result.findings if one.kind == "deadlock" and not one.accepted] == [("B",)]
    assert result.failed
    robots["A"] = ["throw go"]
    result = explore(team(robots, accept={"B": loss}), delivery="run")
    assert [bool(one.accepted) for one in result.findings if one.kind in ("deadlock", "lost")] == [True]


# ---- shipped missions ------------------------------------------------------------------------------------------------


def test_the_resilient_mission_completes_from_every_state() -> None:
    """With tractors that get stuck, weeds out of reach, and answers that come too late."""
    result = explore("models/agriculture_resilient.bpmn", robots={"Tractor": 1}, delivery="run")
    assert result.exhaustive
    assert not result.failed
    assert not any(one.kind == "error" for one in result.findings)


def test_ground_vehicles_have_no_deadlock_but_uncaught_errors() -> None:
    result = explore("examples/ground_vehicles.yaml")
    assert result.exhaustive
    assert not result.failed
    assert {one.kind for one in result.findings} <= {"error", "unneeded"}


@pytest.mark.long
def test_cars_are_told_apart_by_what_they_say() -> None:
    result = explore("examples/convoy.yaml", delivery="run")
    assert result.exhaustive
    assert kinds(result) == {"error"}


# ---- single faults ---------------------------------------------------------------------------------------------------


def test_a_single_fault_that_leaves_another_robot_waiting() -> None:
    """What no fault does in the mission itself, one of DINGO's does."""
    result = explore("models/ground_vehicles.bpmn", faults=True, delivery="run")
    assert not result.failed
    (fault,) = (
        one
        for one in result.findings
        if one.kind == "fault" and one.text.startswith("DINGO's") and "blocked" in one.text
    )
    assert 'REX waits at "done" (Event_DoneCaught) for /done' in fault.text
    assert [str(step) for step in fault.run][-2:] == ["DINGO receives /target_found", 'DINGO\'s "Go To" fails: blocked']
    outcomes = {name: outcome for search in result.searches for name, _, outcome in search.faults}
    assert outcomes["REX's engine dies"] == "the others complete"
    assert "forever" in outcomes["/done to REX is lost"]


def test_an_engine_may_die_before_a_message_starts_its_mission() -> None:
    """The mission is over in the instant in which it starts: an engine that dies in it alone never dies."""
    result = found({"A": ["work", "throw ask", "catch reply"], "B": ["start ask", "throw reply"]}, faults=True)
    outcomes = {
        outcome for search in result.searches for name, _, outcome in search.faults if name == "B's engine dies"
    }
    assert any("A waits" in outcome for outcome in outcomes)


def test_faults_without_a_number_of_their_own_are_left_out_and_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = {"A": ["work", "throw go", "work"], "B": ["catch go", "work"]}
    told = [outcome for search in found(steps, delivery="run", faults=True).searches for outcome in search.faults]
    for module in ("deliveries", "faults", "product", "search"):
        monkeypatch.setattr(f"fame.check.explore.{module}.FAULTS", 3)
    result = found(steps, delivery="run", faults=True)
    assert (len(told), result.cuts, result.exhaustive) == (6, ("more than 2 single faults",), False)
    outcomes = [outcome for search in result.searches for outcome in search.faults]
    assert len(outcomes) == 2
    assert {*outcomes} < {*told}


# ---- bad input -------------------------------------------------------------------------------------------------------


def test_bad_requests_are_refused() -> None:
    for options in ({"limit": 0}, {"delivery": "slow"}, {"timers": "late"}, {"seconds": 0}):
        with pytest.raises(ConfigError):
            found({"A": ["work"]}, **options)
    with pytest.raises(ConfigError, match="unknown multi-instance pool 'Crane'"):
        found({"A": ["work"]}, robots={"Crane": 2})


PUBLISHING = [
    ("signal('done')", True),
    ("x = 1\nprint(signal(name='done'))", True),
    ("robot.publish('/done', 'std_msgs/msg/Empty', {})", True),
    ("signal('done') or log('info', 'done')", True),
    ("log('info', 'done')", False),
    ("'done'", False),
    ("if robot.now > 9: signal('done')", False),
    ("robot.now > 9 and signal('done')", False),
    ("print(signal('done') if robot.now > 9 else 1)", False),
    ("[signal('done') for x in range(int(robot.now))]", False),
    ("print(lambda: signal('done'))", False),
    ("0 < robot.now < signal('done')", False),
]


@pytest.mark.parametrize(("code", "certain"), PUBLISHING)
def test_only_a_signal_outside_of_conditions_and_loops_is_certain(code: str, certain: bool) -> None:
    """A script that only may throw it, and names it otherwise, leaves a robot waiting."""
    maybe = "if robot.now > 99: signal('done')"
    result = found({"A": [f"run await sleep(1)\n{code}\n{maybe}"], "B": ["queue done"]}, delivery="run")
    assert ("deadlock" not in kinds(result)) == certain


def test_scripts_with_effects_are_not_run(tmp_path: Path) -> None:
    target = tmp_path / "written"
    code = f"open({str(target)!r}, 'w').write('x')\nn = 1"
    result = found(
        {"A": [f"run {code}", "run __import__('os').abort()\nn = 2", ("if", "n == 1", ["work"], ["person"])]}
    )
    assert result.exhaustive
    assert not target.exists()
    assert not any(one.kind == "unreachable" for one in result.findings), (
        "the value is unknown: both branches are taken"
    )


def test_a_condition_that_raises_is_an_error_finding() -> None:
    result = found({"A": ["run n = 0", ("if", "1 // n == 1", ["work"], ["work"])]})
    (one,) = (one for one in result.findings if one.kind == "error")
    assert "ZeroDivisionError" in one.text


GATEWAY = process(
    '<startEvent id="s"/><scriptTask id="t"><script>x = open("level").read()</script></scriptTask>'
    '<exclusiveGateway id="g"/><endEvent id="high"/><endEvent id="low"/><sequenceFlow id="a" sourceRef="s" '
    'targetRef="t"/><sequenceFlow id="b" sourceRef="t" targetRef="g"/><sequenceFlow id="c" sourceRef="g" '
    'targetRef="high"><conditionExpression>x &gt; 0</conditionExpression></sequenceFlow><sequenceFlow id="d" '
    'sourceRef="g" targetRef="low"><conditionExpression>OTHERWISE</conditionExpression></sequenceFlow>'
)


@pytest.mark.parametrize(("otherwise", "kinds"), [("x &lt;= 0", []), ("not x &gt; 0", []), ("x &lt; 0", ["error"])])
def test_conditions_of_which_one_is_always_true_leave_no_way_out_of_the_gateway(
    otherwise: str, kinds: list[str]
) -> None:
    result = explore(fame.read(GATEWAY.replace("OTHERWISE", otherwise).encode()))
    assert [one.kind for one in result.findings] == kinds  # and both ends are reached


def test_an_unknown_value_may_be_unpacked() -> None:
    result = explore(
        team({"A": ["run place = robot.now", "run x, y = place", ("if", "x > 1", ["work"], [])]}), delivery="run"
    )
    assert not result.findings


@pytest.mark.parametrize(
    "change",
    [
        "known[robot.now] = 1",
        "other = known; other[robot.now] = 1",
        "known.update({robot.now: 1})",
        "import operator; operator.setitem(known, robot.now, 1)",
        "import functools; functools.reduce(dict.update, [known, {1: 1}])",
        "known.unheard_of(1)",
        "[part.change() for part in (known, robot.now)]",
    ],
)
def test_what_a_script_changes_in_place_is_unknown_if_it_cannot_be_run(change: str) -> None:
    steps: Steps = ["run known = {}", f"run {change}", ("if", "len(known) > 0", ["work"], ["work"])]
    result = explore(team({"A": steps}), delivery="run")
    assert not result.findings  # neither way is called unreachable


def test_a_deadlock_is_one_with_single_faults_too() -> None:
    """That an engine might die is no way out."""
    result = found({"A": ["catch b", "throw a"], "B": ["catch a", "throw b"]}, faults=True)
    assert {"deadlock", "fault"} <= kinds(result)
    assert result.failed


def test_a_single_fault_is_not_followed_by_another_one() -> None:
    """REX goes on if one of its behaviours never ends beside the others; only DINGO could keep it waiting."""
    result = explore("models/ground_vehicles.bpmn", faults=True, delivery="run")
    outcomes = {name: outcome for search in result.searches for name, _, outcome in search.faults}
    assert outcomes['REX\'s "Go To" (Activity_Explore_GoTo) never ends'] == "the others complete"


def test_a_number_stays_known_whatever_function_it_is_given_to() -> None:
    steps: Steps = ["run n = 1", "run import heapq; heap = []; heapq.heappush(heap, n)", ("if", "n == 1", [], ["work"])]
    (one,) = explore(team({"A": steps}), delivery="run").findings
    assert one.kind == "unreachable"


JAVASCRIPT = process(
    """
    <startEvent id="Start"/>
    <scriptTask id="Make" scriptFormat="python"><script>items = []\ncount = 0</script></scriptTask>
    <scriptTask id="Change" scriptFormat="javascript"><script>
      const items = this.environment.variables.items; CHANGE; next();
    </script></scriptTask>
    <exclusiveGateway id="Any" default="Any_No"/>
    <endEvent id="Yes"/><endEvent id="No"/>
    <sequenceFlow id="Start_Make" sourceRef="Start" targetRef="Make"/>
    <sequenceFlow id="Make_Change" sourceRef="Make" targetRef="Change"/>
    <sequenceFlow id="Change_Any" sourceRef="Change" targetRef="Any"/>
    <sequenceFlow id="Any_Yes" sourceRef="Any" targetRef="Yes">
      <conditionExpression>len(items) > count</conditionExpression>
    </sequenceFlow>
    <sequenceFlow id="Any_No" sourceRef="Any" targetRef="No"/>
    """
)


@pytest.mark.parametrize("change", ["items.push(1)", "items[0] = 1", "items.first = 1"])
def test_what_javascript_changes_in_place_is_unknown(change: str) -> None:
    result = explore(fame.read(JAVASCRIPT.replace("CHANGE", change).encode()), delivery="run")
    assert not result.findings  # neither end is called unreachable


def test_a_name_is_known_though_a_cost_is_not() -> None:
    """Who wins by the lowest bid is unknown, but it is one of those that have bidden."""
    bids = "run bids = {'A': x, 'B': abs(x)}"
    steps: Steps = ["run x = robot.now", bids, "run best = min(sorted(bids), key=lambda name: bids[name])"]
    steps += [("if", "best == 'A'", ["work"], [("if", "best == 'B'", ["work"], ["run raise ValueError"])])]
    assert {one.kind for one in explore(team({"R": steps}), delivery="run").findings} == {"unreachable"}


@pytest.mark.parametrize(
    "number", ["math.hypot(x, 1)", "math.dist((x, 0), (1, 1))", "float(x)", "int(x) + 7", "round(x)"]
)
def test_what_is_computed_from_something_unknown_is_unknown(number: str) -> None:
    steps: Steps = ["run x = robot.now", f"run name = 'a'; y = {number}", ("if", "y == 5", ["work"], ["work"])]
    steps += [("if", "name == 'a'", [], ["work"])]
    (one,) = explore(team({"R": steps}), delivery="run").findings
    assert one.kind == "unreachable"  # the name is known


@pytest.mark.long_but("1*")
@pytest.mark.parametrize(("carriers", "limit"), [(1, 1_000), (2, 20_000), (3, 400_000)])
def test_the_warehouse_completes_from_every_state(carriers: int, limit: int) -> None:
    result = explore("examples/warehouse.yaml", robots={"Carrier": carriers}, limit=limit)
    assert result.exhaustive
    assert {one.kind for one in result.findings if one.level != "note"} == {"dropped", "error"}
    assert all("may fail" in one.text and one.level == "warning" for one in result.findings if one.kind == "error")


@pytest.mark.long
def test_an_award_that_is_lost_leaves_nobody_waiting() -> None:
    result = explore("models/warehouse.bpmn", robots={"Carrier": 1}, delivery="run", faults=True)
    outcomes = {name: outcome for search in result.searches for name, _, outcome in search.faults}
    assert outcomes["/parcel_awarded to Carrier_1 is lost"] == "the others complete"


@pytest.mark.parametrize(
    "around",
    ["{0}<boundaryEvent id='b' attachedToRef='t'><errorEventDefinition/></boundaryEvent>",
     "<subProcess id='sub'><startEvent id='i'/>{0}<sequenceFlow id='k' sourceRef='i' targetRef='t'/></subProcess>"
     "<boundaryEvent id='b' attachedToRef='sub'><errorEventDefinition/></boundaryEvent>"],
)  # fmt: skip
def test_an_activity_that_is_left_through_its_boundary_has_been_entered(around: str) -> None:
    script = "<scriptTask id='t' scriptFormat='python'><script>x = 1 // 0</script></scriptTask>"
    first = "sub" if "sub" in around else "t"
    model = process(
        f"<startEvent id='s'/>{around.format(script)}<endEvent id='e'/><sequenceFlow id='f' sourceRef='s' "
        f"targetRef='{first}'/><sequenceFlow id='g' sourceRef='b' targetRef='e'/>"
    )
    assert not explore(fame.read(model.encode())).findings


def test_states_with_successors_that_are_not_explored_are_neither_stuck_nor_doomed() -> None:
    """B could end once more instances run than are explored."""
    robots: dict[str, Steps] = {"A": [("while", ["work", "throw go"])], "B": ["start go", "person"]}
    result = found(robots, delivery="run")
    assert "growth" in kinds(result)
    assert not kinds(result) & {"deadlock", "lost"}


def test_what_is_lost_in_one_delivery_and_taken_in_another_is_not_always_lost() -> None:
    robots: dict[str, Steps] = {"A": ["throw x", "throw y"], "B": ["catch y", ("race", ["catch x"], ["timer PT1S"])]}
    assert "always-lost" in kinds(found(robots, delivery="run"))
    assert "always-lost" not in kinds(found(robots))


def test_a_signal_that_nothing_throws_has_a_named_source() -> None:
    robots: dict[str, Steps] = {"A": ["catch order"], "B": ["work"]}
    text = text_of(robots)
    (one,) = explore(fame.read(text.encode())).findings
    assert (one.kind, one.level) == ("outside", "warning")
    assert "no robot throws /order" in one.text
    source = '<extensionElements><camunda:properties><camunda:property name="outside" value="the office"/></camunda:properties></extensionElements>'  # noqa: E501
    named = text.replace('<signalEventDefinition signalRef="Signal_order"/>', f'{source}<signalEventDefinition signalRef="Signal_order"/>')  # noqa: E501  # fmt: skip
    assert not explore(fame.read(named.encode())).findings
    assert not found({"A": ["catch order"]}).findings


@pytest.mark.parametrize("before", ["await sleep(1)", "import json; name = json.loads(name)"])
def test_what_a_script_computes_may_be_the_signal_that_a_robot_waits_for(before: str) -> None:
    """It is not executed, and another robot throws the signal by name, later than it could."""
    text = drawn(row(script(f"name = 'done'; {before}; signal(name)")), row(catch("c"), throw("d"), mark="2"))
    assert not explore(fame.read(text.encode())).findings


def test_a_signal_of_the_scenario_has_a_source(tmp_path: Path) -> None:
    (tmp_path / "m.bpmn").write_text(text_of({"A": ["catch order"], "B": ["work"]}))
    scenario = tmp_path / "s.yaml"
    scenario.write_text("model: m.bpmn\nsignal: [{name: order, at: 3}]\n")
    assert not explore(scenario).findings


def test_what_a_simulated_robot_publishes_has_a_source(tmp_path: Path) -> None:
    text = text_of({"A": ["catch order"], "B": ["work"]}).replace('name="order"', 'name="B/camera/weeds"')
    (tmp_path / "m.bpmn").write_text(text)
    scenario, lines = tmp_path / "s.yaml", ["model: m.bpmn", "world:", "  size: [9, 9]", "  robots:"]
    robots = ["    A: {type: car, at: [2, 2]}", "    B: {type: drone, at: [5, 5]}"]
    scenario.write_text("\n".join([*lines, *robots]))
    assert not explore(scenario).findings
    scenario.write_text("\n".join([*lines, *robots]).replace("drone", "car"))
    assert [one.kind for one in explore(scenario).findings] == ["outside"]


def test_the_first_line_says_that_only_one_order_was_explored() -> None:
    robots: dict[str, Steps] = {"A": ["throw x"], "B": ["work"]}
    assert "delivery run, only the order of fame run)" in found(robots, delivery="run").summary()
    assert "only" not in found(robots).summary()
