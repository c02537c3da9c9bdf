"""Verdicts on small collaborations, each known beforehand from chapter 13 of BPMN 2.0 and docs/semantics.md."""

import pytest
from collaborations import Steps
from test_exploration_soundness import explored

PROVED, REFUTED = "proved", "refuted"
# fmt: off
CASES: dict[str, tuple[dict[str, Steps], dict[str, str]]] = {
    "a boundary timer interrupts, or not": ({"A": [("guard", ["work"], "timer PT4S", ["throw t"])], "B": ["catch t"]},
        {"A completes": PROVED, "B completes": REFUTED, "A throws /t at most 1 times": PROVED}),
    "a timer that does not interrupt fires once": ({"A": [("watch", ["work"], "timer PT4S", ["throw t"]), "throw z"]},
        {"A throws /t at most 1 times": PROVED, "A throws /z": PROVED, "never A throws /t": REFUTED}),
    "an inner event of any code before an outer exact one": (
        {"A": [("guard", [("guard", ["fail c"], "error", ["throw inner"])], "error c", ["throw outer"])]},
        {"never A throws /outer": PROVED, "never A throws /inner": REFUTED, "never A fails": PROVED}),
    "the error of a handler starts outside of its scope": (
        {"A": [("guard", [("scope", ["error c"], "error c", ["error c"])], "error c", ["throw outer"])]},
        {"A throws /outer": PROVED, "never A fails": PROVED}),
    "terminate in a sub-process": ({"A": [("scope", ["stop"], "timer PT4S", ["work"]), "throw after"]},
        {"A throws /after": PROVED}),
    "terminate of a process": ({"A": [("and", ["work", "throw x"], ["work", "stop"])]},
        {"A throws /x": REFUTED, "A ends": PROVED, "A completes": PROVED}),
    "a signal is lost on who throws it and then waits": ({"A": ["throw a", "catch a"]}, {"A completes": REFUTED}),
    "a parallel branch hears the other": ({"A": [("and", ["throw a"], ["catch a"])]}, {"A completes": PROVED}),
    "a parallel branch hears the other, first": ({"A": [("and", ["catch a"], ["throw a"])]}, {"A completes": PROVED}),
    "a message is for one": ({"A": ["send m"], "B": [("and", ["receive m"], ["receive m"])]}, {"B completes": REFUTED}),
    "two messages are for two": ({"A": ["send m", "send m"], "B": [("and", ["receive m"], ["receive m"])]},
        {"B completes": PROVED}),
    "a signal is for all": ({"A": ["throw a"], "B": [("and", ["catch a"], ["catch a"])]}, {"B completes": PROVED}),
    "a queue keeps": ({"A": ["throw a"], "B": ["work", "queue a"]}, {"B completes": PROVED}),
    "without a queue it is lost": ({"A": ["throw a"], "B": ["work", "catch a"]}, {"B completes": REFUTED}),
    "a race against time, messages being fast": (
        {"A": ["throw a"], "B": [("race", ["catch a", "throw got"], ["timer PT9S", "throw late"])]},
        {"B throws /got": PROVED, "never B throws /late": PROVED}),
    "compensation in reverse order": (
        {"A": [("done", ["run n = 1"], ["throw u1"]), ("done", ["run n = 1"], ["throw u2"]), "undo"]},
        {"A throws /u1 only after A throws /u2": PROVED, "A throws /u2 only after A throws /u1": REFUTED,
         "A throws /u1": PROVED}),
    "what is not completed is not compensated": ({"A": [("and", [("done", ["work"], ["throw u"])], ["undo"])]},
        {"never A throws /u": PROVED, "A completes": PROVED}),
    "a cancelled transaction": (
        {"A": [("deal", [("done", ["run n = 1"], ["throw u"]), "cancel"], ["throw cancelled"])]},
        {"A throws /u": PROVED, "A throws /cancelled only after A throws /u": PROVED, "A throws /cancelled": PROVED}),
    "a transaction": ({"A": [("deal", [("done", ["run n = 1"], ["throw u"]), "work"], ["throw cancelled"])]},
        {"never A throws /u": PROVED, "never A throws /cancelled": PROVED}),
    "an escalation interrupts": ({"A": [("guard", ["escalate e", "throw after"], "escalation e", ["throw esc"])]},
        {"A throws /esc": PROVED, "never A throws /after": PROVED}),
    "an escalation goes on": ({"A": [("watch", ["escalate e", "throw after"], "escalation e", ["throw esc"])]},
        {"A throws /esc": PROVED, "A throws /after": PROVED}),
    "an escalation that nothing catches": ({"A": ["escalate f-1", "throw after"]},
        {"A throws /after": PROVED, "never A fails": PROVED}),
    "an escalation leaves a call": (
        {"A": [("watch", [("call", "H")], "escalation", ["throw esc"])], "H": ["escalate f-1", "throw after"]},
        {"A throws /esc": PROVED, "A throws /after": PROVED}),
    "an escalation of another code": (
        {"A": [("watch", [("call", "H")], "escalation e", ["throw esc"])], "H": ["escalate f-1", "throw after"]},
        {"never A throws /esc": PROVED, "A throws /after": PROVED}),
    "a handler interrupts": ({"A": ["throw a"], "B": [("scope", ["work", "throw done"], "a", ["throw h"])]},
        {"B throws /h": PROVED, "never B throws /done": PROVED}),
    "a handler for each signal": ({"A": ["throw a", "throw a"], "B": [("beside", ["work"], "a", ["throw h"])]},
        {"B throws /h at most 1 times": REFUTED, "B throws /h at most 2 times": PROVED}),
    "one after the other": ({"A": [("turns", 2, ["work", "throw x"])]},
        {"A throws /x at most 2 times": PROVED, "A throws /x at most 1 times": REFUTED}),
    "terminate ends one instance": ({"A": [("each", 2, ["throw x", "stop"]), "throw z"]},
        {"A throws /x at most 1 times": REFUTED, "A throws /x at most 2 times": PROVED, "A throws /z": PROVED}),
    "an error ends all instances": ({"A": [("guard", [("turns", 2, ["throw x", "error c"])], "error c", ["throw h"])]},
        {"A throws /x at most 1 times": PROVED, "A throws /h": PROVED}),
    "an inclusive gateway": ({"A": [("some", ["throw x"], ["throw y"]), "throw z"]},
        {"A completes": PROVED, "A throws /x": REFUTED, "never A throws /x": REFUTED,
         "A throws /z at most 1 times": PROVED}),
    "a code in quotes, of two calls": (
        {"A": [("guard", [("call", "H")], "error it's \"off\"", ["work"]), ("call", "H")], "H": ["fail it's \"off\""]},
        {"never A fails": REFUTED, "A completes": REFUTED}),
    "a condition that is true at the start": (
        {"A": ["run n = 1", ("guard", ["work", "throw x"], "condition n == 1", ["throw h"])]},
        {"A throws /h": PROVED, "never A throws /x": PROVED}),
    "a condition by another branch": ({"A": ["run n = 0", ("and", ["work", "run n = 1"], ["until n == 1", "throw h"])]},
        {"A throws /h": PROVED, "A completes": PROVED}),
    "another code": ({"A": [("guard", ["fail no-go"], "error c", ["throw h"])]},
        {"never A throws /h": PROVED, "never A fails": REFUTED}),
    "any exception in a call": ({"A": [("guard", [("call", "H")], "error", ["throw h"])], "H": ["crash"]},
        {"never A fails": PROVED, "never A throws /h": REFUTED}),
    "a code is not script": ({"A": [("guard", ["raise c"], "error script", ["throw h"])]},
        {"never A throws /h": PROVED, "never A fails": REFUTED}),
    "each signal starts an instance": ({"A": ["throw s", "throw s"], "B": ["start s", "throw x"]},
        {"B throws /x at most 1 times": REFUTED, "B throws /x at most 2 times": PROVED}),
    "an output of a call": (
        {"A": ["run n = 0", ("mapped", "H"), ("if", "n == 1", ["throw yes"], ["throw no"])], "H": ["run n = 1"]},
        {"A throws /yes": PROVED, "never A throws /no": PROVED}),
    "a loop for ever": ({"A": [("while", ["work", "throw x"])], "B": ["catch x"]},
        {"B completes": PROVED, "A completes": REFUTED}),
    "a link": ({"A": ["jump", "throw x"]}, {"A throws /x": PROVED}),
    "an error cancels other branches": (
        {"A": [("guard", [("and", ["work", "throw x"], ["error c"])], "error c", ["throw h"])]},
        {"never A throws /x": PROVED, "A throws /h": PROVED}),
    "an error that nothing catches": ({"A": [("and", ["work", "throw x"], ["error c"])], "B": ["catch x"]},
        {"never A throws /x": PROVED, "never A completes": PROVED, "B completes": REFUTED}),
    "a signal and work": ({"A": ["work", "throw a"], "B": [("guard", ["work", "throw x"], "a", ["throw h"])]},
        {"never B throws /h": REFUTED, "never B throws /x": REFUTED, "B completes": PROVED,
         "never B throws /h before B throws /x": REFUTED}),
    "a handler that outlives its activity": (
        {"A": ["throw a"], "B": [("watch", ["work"], "a", ["work", "throw h"]), "throw z"]},
        {"B throws /h": PROVED, "B throws /h at most 1 times": PROVED, "B throws /z only after B throws /h": REFUTED}),
    "terminate ends handlers": ({"A": ["throw a"], "B": [("watch", ["work"], "a", ["work", "throw h"]), "stop"]},
        {"B throws /h": REFUTED}),
    "compensation in a call": ({"A": [("call", "H"), "undo"], "H": [("done", ["run n = 1"], ["throw u"])]},
        {"A throws /u": PROVED}),
    "compensation of each instance": ({"A": [("turns", 2, [("done", ["run n = 1"], ["throw u"])]), "undo"]},
        {"A throws /u at most 1 times": REFUTED, "A throws /u at most 2 times": PROVED, "A throws /u": PROVED}),
    "an error leaves a transaction": (
        {"A": [("guard", [("deal", [("done", ["run n = 1"], ["throw u"]), "error c"], ["throw cancelled"])],
         "error c", ["throw h"])]},
        {"never A throws /u": PROVED, "A throws /h": PROVED, "never A throws /cancelled": PROVED}),
    "what was armed first gets a message": (
        {"A": ["send m"], "B": [("race", ["receive m", "throw one"], ["receive m", "throw two"])]},
        {"B throws /one": PROVED, "never B throws /two": PROVED}),
    "an error through a call": (
        {"A": [("guard", [("call", "H")], "error d", ["throw h"])], "H": [("guard", ["fail d"], "error c", ["work"])]},
        {"never A throws /h": REFUTED, "never A fails": PROVED}),
    "two signals in turn": ({"A": ["work", "throw a", "work", "throw b"], "B": ["catch a", "catch b"]},
        {"B completes": PROVED, "B completes only after A throws /b": PROVED}),
}
# fmt: on


@pytest.mark.parametrize("name", CASES)
def test_a_verdict_is_that_of_the_standard(name: str) -> None:
    robots, verdicts = CASES[name]
    assert {proof.name: proof.verdict for proof in explored(robots, *verdicts).properties} == verdicts
