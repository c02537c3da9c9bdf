"""Properties: their grammar, what they may name, and that monitors judge as docs/property_sentences.md says."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from compare_properties import VOCABULARY, Item, differences, judged

from fame.config.loader import parse_document
from fame.errors import ConfigError
from fame.properties import Judge, Location, Property, Vocabulary, compile, parse
from fame.properties.conditions import ValueSource
from fame.properties.files import properties_of

DOCS = Path(__file__).parent.parent / "docs"
PAGE = (DOCS / "property_sentences.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```yaml\n(properties:.*?)```", (DOCS / "properties.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS)
def test_each_example_of_the_documentation_can_be_read(block: str) -> None:
    found = properties_of(parse_document(block).mapping()["properties"])
    assert [each.name for each in found] == re.findall(r"^  (\w+):", block, re.MULTILINE)


@pytest.mark.parametrize(
    "pattern", re.findall(r"^\| `(?!after E, \.|\.|between E and G, \.)(.*?)`(?: or `(.*?)`)? \|", PAGE, re.MULTILINE)
)
def test_each_pattern_of_the_table_can_be_read(pattern: tuple[str, str]) -> None:
    events = {"E": "A starts x", "F": "B completes y", "G": "A fails", "C": "A.v > 1"}
    for sentence in filter(None, pattern):
        compile(parse(re.sub(r"\b[EFGC]\b", lambda letter: events[letter[0]], sentence)), VOCABULARY)


@pytest.mark.long_but("?", "[1-4]?")
@pytest.mark.parametrize("seed", range(400))
def test_monitors_say_what_the_sentences_mean(seed: int) -> None:
    assert list(differences(seed)) == []


WRONG = {
    "alwys A.v > 1": (1, "between or an event, got 'alwys'; did you mean 'always'?"),
    "after A starts x B starts y": (18, "expected ',' and what has to hold after this event, got 'B'"),
    "A strts x": (3, "expected what A does"),
    "A completes within 5": (21, "expected a unit (ms, s, min, h), got the end of the sentence"),
    "A completes within soon": (20, "expected a time, as in 12 s, got 'soon'"),
    "A completes within 0 s": (20, "expected a time above 0, got 0"),
    "A completes within 1e999 s": (20, "expected a time below 30 years, got 1e999"),
    "never A throws /go where id > 1 and": (33, "expected the end of the sentence, got 'and'"),
    'A fails with "blocked"': (9, "an error code needs an element that fails"),
    "A completes wihtin 5 s": (20, "got '5'; 'wihtin' is read as an element: did you mean 'within'?"),
    "A completes wihtin": (13, "A has no element 'wihtin'; known are"),
    "A fails at within 5 s": (12, "expected an element, by label or id, got 'within'"),
    "A.v > 1": (1, "expected an event here; a condition follows always or never"),
    "distance(A, B) > 1": (1, "expected an event here; a condition follows always or never"),
    "always A.v": (11, "expected one of < <= > >= == !=, got the end of the sentence"),
    "always A.v = 1": (12, "unexpected '='"),
    "always 1 < 2": (8, "expected a value of the team in this comparison, got two constants"),
    "always A > 1": (10, "expected '.' and a variable of A, got '>'"),
    "always distance(A) > 1": (18, "expected ',' and a second robot, got ')'"),
    "always distance(A, A) > 1": (20, "expected another robot, or distance(any two A) for those of a pool"),
    "always distance(A, C) > 1": (20, "unknown robot or pool 'C'; known are: A, B, T_1, T_2, T"),
    "always A.speed > 1": (8, "A has no variable 'speed'; known are: v, w, battery"),
    "always /found > 1": (15, "expected '.' and a field of the message, got '>'"),
    "never": (6, "expected a robot or pool, got the end of the sentence"),
    "": (1, "expected a robot or pool, got the end of the sentence"),
    "never some": (11, "expected a robot or pool, got the end of the sentence"),
    'A starts "X': (10, "expected a closing quotation mark"),
    "A starts z": (10, "A has no element 'z'; known are: X, Y, found, done"),
    'A starts "Xx"': (10, "A has no element 'Xx'; did you mean 'X'?"),
    "Aa starts x": (1, "unknown robot or pool 'Aa'; did you mean 'A'?"),
    "A throws found": (10, "expected a topic, as in /weed_found or \"Weed found\", got 'found'"),
    "A throws /fond": (10, "no event of A throws /fond; did you mean '/found'?"),
    "A catches /done": (11, "no event of A catches /done; known are: /found"),
    "A catches /found where id > 1": (18, "only throws takes a condition: which message was caught is not recorded"),
    "A throws /found where > 1": (23, "expected a field of the message, got '>'"),
    "A throws /found where id": (25, "expected one of < <= > >= == !=, got the end of the sentence"),
    "A throws /found where id > big": (28, "expected a number, a text in quotation marks, true or false, got 'big'"),
    "A throws /found where name > 1": (23, "name is no field"),
    "A starts x at most two times": (20, "expected a whole number of times, got 'two'"),
    "A starts x at most 2": (21, "expected 'times', got the end of the sentence"),
    "A starts x each time after B starts y": (22, "expected 'time only after', got 'after'"),
    "between A starts x, B starts y": (19, "expected 'and', got ','"),
    "between A starts x and B starts y, never A starts until B starts": (51, "expected the end of the sentence"),
    "A starts x only after B starts y with the same id": (34, "expected the end of the sentence, got 'with'"),
    "after A starts x, B throws /done with the same id": (34, "needs two events that throw a message"),
    'after A starts "with the same", B throws /done with  the same id': (48, "needs two events that throw a message"),
    "A fails at": (11, "expected an element, by label or id, got the end of the sentence"),
    "A completes x B": (15, "expected the end of the sentence, got 'B'"),
    "always A.v[x] > 1": (12, "expected the index of a list, got 'x'"),
}  # fmt: skip


def test_failures_and_cancellations_are_counted_with_and_without_their_element() -> None:
    for event in ("A fails", 'A fails at "X"', "A is cancelled", 'A is cancelled at "X"'):
        made = parse(f"{event} at most 2 times")
        assert (made.pattern, made.count, made.main and made.main.text) == ("at most", 2, event)


@pytest.mark.parametrize("id", ["wait", "Wait", "width", "match", "reach", "end", "mast", "time1", "afterburn"])
def test_an_id_may_resemble_a_word_of_the_grammar(id: str) -> None:
    made = parse(f"after A starts {id}, B completes {id} within 5 s")
    assert [each.target.text for each in made.occurrences] == [id, id]
    assert made.bound == 5 * 10**9


def test_a_number_may_have_the_exponent_that_python_writes() -> None:
    assert [each.right.constant for each in parse(f"always A.v < {1e20!r} and A.v > -2.5E-3").condition] == [
        1e20,
        -2.5e-3,
    ]


@pytest.mark.parametrize("sentence", WRONG)
def test_a_wrong_sentence_is_refused_where_it_is_wrong(sentence: str) -> None:
    column, text = WRONG[sentence]
    with pytest.raises(ConfigError) as error:
        compile(parse(sentence, Location("team.yaml", 7, 1), "p"), checked())
    assert str(error.value).startswith(f"team.yaml:7:{column}: properties.p: ")
    assert text in str(error.value)


def checked() -> Vocabulary:
    wrong = lambda topic, path: "" if path == ("id",) else f"{path[0]} is no field"  # noqa: E731
    return replace(VOCABULARY, check_field=wrong)


def test_all_wrong_sentences_of_a_file_are_told_at_once() -> None:
    document = parse_document("properties:\n  a: always A.v > 1\n  b: alwys A.v > 1\n  c: A\n")
    with pytest.raises(ConfigError, match=r"line 3: properties\.b: .* got 'alwys'") as raised:
        properties_of(document.mapping()["properties"])
    assert [note.partition(", ")[0] for note in raised.value.__notes__] == [
        "line 4: properties.c: expected what A does (starts"
    ]


def test_a_label_that_occurs_twice_is_refused_with_the_ids() -> None:
    twice = replace(VOCABULARY.robots["A"], own={"x": "Go To", "y": "Go To"})
    with pytest.raises(ConfigError, match="A has 2 elements labelled 'Go To'; expected an id: x, y"):
        compile(parse('A starts "Go To"'), replace(VOCABULARY, robots={"A": twice}))


def test_the_state_of_a_monitor_is_plain_data_that_can_be_kept() -> None:
    monitor = compile(parse("after A starts x, B completes y within 5 s"), VOCABULARY)
    before = monitor.step(monitor.initial, 10**9, ("A", "x", "enter", None))
    assert (monitor.verdict(before).word, monitor.deadline(before)) == ("pending", 6 * 10**9)
    for _ in range(2):  # from the same state twice
        state = monitor.step(before, 3 * 10**9, ("B", "y", "leave", None))
        assert monitor.verdict(state)[:2] == ("holds", 3.0)
    assert monitor.verdict(monitor.step(before, 6 * 10**9 - 1)).word == "pending"
    assert monitor.verdict(monitor.step(before, 6 * 10**9)).word == "violated"
    assert len({before, monitor.initial, before}) == 2


def test_a_bound_is_closed() -> None:
    made = parse("after A starts x, B completes y within 5 s")
    assert judged(made, [event(1, "A", "x", "enter"), event(6, "B", "y", "leave")], 10**10, True) == (
        "holds",
        0.0,
        None,
    )


def event(second: int, *what: str) -> Item:
    return Item(second * 10**9, (*what, None))


@pytest.mark.parametrize(
    ("sentence", "right"),
    [
        ("after A throws /found until A completes, B starts y within 5 s", ("violated", None, 11)),
        ("after A throws /found, B starts y within 5 s until A completes", ("violated", None, 11)),
        ("between A throws /found and A completes, B starts y", ("violated", None, 9)),
        ("after A throws /found, B starts y within 5 s", ("violated", None, 11)),
        ("between A throws /found and A completes, B completes y only after B starts y", ("violated", None, 8)),
        (
            "between A throws /found and A completes, B completes y each time only after B starts y",
            ("violated", None, 8),
        ),
        ("between A throws /found and A completes, B starts y at most 1 times", ("holds", 0.0, None)),
    ],
)
def test_each_event_that_opens_a_scope_counts_while_another_is_open(
    sentence: str, right: tuple[str, float | None, int | None]
) -> None:
    word, slack, time = right
    thrown = [event(2, "A", "throw", "leave"), event(6, "A", "throw", "leave")]
    items = [thrown[0], event(3, "B", "y", "enter"), thrown[1], event(8, "B", "y", "leave")]
    end = [event(9, "A", "P_A", "end")] if "within" not in sentence else []
    items += [item._replace(event=(*item.event[:3], "completed")) for item in end if item.event is not None]
    expected = word, slack, None if time is None else time * 10**9
    assert judged(parse(sentence), items, 90 * 10**9, True) == expected


@pytest.mark.parametrize(
    ("sentence", "right"),
    [
        ("between A throws /found and A completes, never B starts y before B completes y", ("holds", None, None)),
        ("after A throws /found, never B starts y before B completes y", ("violated", None, 7)),
        ("after B starts x, B ends x until A throws /done", ("violated", None, 9)),
        ("between B starts x and A throws /done, B ends x", ("violated", None, 9)),
        ("between A throws /found and A throws /found, A throws /done with the same id", ("holds", None, None)),
    ],
)
def test_a_scope_changes_nothing_else_of_its_pattern(
    sentence: str, right: tuple[str, float | None, int | None]
) -> None:
    items = [
        event(1, "A", "throw", "leave")._replace(message={"id": 1}),
        event(2, "A", "reply", "leave")._replace(message={"id": 1}),
        event(3, "A", "P_A", "end")._replace(event=("A", "P_A", "end", "completed")),
        *(event(second, "B", "x", what) for second, what in ((4, "enter"), (5, "enter"), (6, "leave"))),
        event(7, "B", "y", "enter"),
    ]
    time = right[2] and right[2] * 10**9
    assert judged(parse(sentence), items, 9 * 10**9, True) == (*right[:2], time)


@pytest.mark.parametrize(
    ("sentence", "good"),
    [("never A.battery < 0.2", 0.9), ("always A.battery < 0.2", 0.1), ("never A.battery != 0.2", 0.2)],
)
def test_a_comparison_with_what_was_not_measured_is_not_known(sentence: str, good: float) -> None:
    def said(*charges: float) -> str:
        source = ValueSource("battery", "A")
        items = [Item(second * 10**9, source=source, value=charge) for second, charge in enumerate(charges)]
        return judged(parse(sentence), items, 10**10, True)[0]

    assert said(math.nan) == said(good, math.nan) == said(math.nan, good) == "not known"
    judge = Judge([compile(parse(sentence), VOCABULARY)])
    judge.sample(2 * 10**9, ValueSource("battery", "A"), math.nan)
    assert judge.finish(10**10, complete=True)[0].text == "A.battery is not known at 2 s"


def test_what_is_false_decides_beside_what_was_not_measured() -> None:
    values = {"v": math.nan, "w": 3}
    items = [Item(0, source=ValueSource("variable", "A", name), value=value) for name, value in values.items()]
    for sentence, word in {
        "never A.v > 1 and A.w > 3": "holds",
        "always A.v > 1 and A.w > 3": "violated",
        "never A.v > 1 and A.w > 2": "not known",
    }.items():
        assert judged(parse(sentence), items, 10**9, True)[0] == word
    thrown = [Item(10**9, ("A", "throw", "leave", None), {"id": math.nan, "kind": 1})]
    for where, word in {"id > 1 and kind > 1": "holds", "kind > 1 and id > 1": "holds", "id > 1": "not known"}.items():
        assert judged(parse(f"never A throws /found where {where}"), thrown, 10**10, True)[0] == word


def test_numbers_of_any_size_are_compared() -> None:
    items = [Item(0, source=ValueSource("variable", "A", "v"), value=10**400)]
    assert judged(parse("always A.v > 3.5"), items, 10**9, True)[:2] == ("holds", math.inf)
    assert judged(parse("always A.v <= 3"), items, 10**9, True)[:2] == ("violated", -math.inf)


@pytest.mark.parametrize(
    "sentence",
    ["never A throws /found where id > 1", "B throws /done each time only after A throws /found with the same id"],
)
def test_nor_is_a_message_whose_field_was_not_measured(sentence: str) -> None:
    thrown = Item(10**9, ("A", "throw", "leave", None), {"id": math.nan})
    assert judged(parse(sentence), [thrown], 10**10, True)[0] == "not known"


def test_lost_events_make_what_needs_them_not_known() -> None:
    sentences = ("after A starts x, B completes y", "never A starts x", "never B starts y", "never A fails")
    judge = Judge([compile(parse(each, name=each), VOCABULARY) for each in sentences])
    judge.event(1, "A", "x", "enter")
    judge.lose("A", "2 batches of A were lost")
    words = [(each.verdict, each.text) for each in judge.finish(10, complete=True)]
    lost = "2 batches of A were lost"
    assert words == [
        ("not known", lost), ("violated", "A starts x at 1e-09 s"), ("holds", ""), ("not known", lost)
    ]  # fmt: skip


def test_a_robot_with_any_name_stands_in_quotation_marks() -> None:
    robots = {name: replace(VOCABULARY.robots["A"], process="P") for name in ("Weed Robot", "after", "R2/D2")}
    named = Vocabulary(robots)
    for sentence in (
        'after "Weed Robot" throws /found, some "R2/D2" starts "X" within 2 s',
        'never "after" fails at "X" before "Weed Robot" completes',
        'always "R2/D2".v > 1 and distance("after", "R2/D2") > 0.5 until "after" completes',
        'never "after".v == "text"',
        'never "text" == "Weed Robot".v',
    ):
        assert compile(parse(sentence), named).parts
    with pytest.raises(ConfigError, match="a name of several words is in quotation marks"):
        parse("Weed Robot completes")


def test_a_signal_may_be_named_as_in_the_diagram() -> None:
    for target in ('"Order received"', "/Order_received"):
        (event,) = filter(None, (parse(f"A throws {target}").main,))
        assert event.target.text == "/Order_received"


def test_places_of_sentences_are_those_of_the_file() -> None:
    document = parse_document('properties:\n  one: A starts\n  two: "B starts"\n', "f.yaml")
    found: tuple[Property, ...] = properties_of(document.mapping()["properties"])
    assert [each.place for each in found] == [("f.yaml", 2, 8), ("f.yaml", 3, 9)]
