"""Two engines of one name, as after a network was split and is whole again: each tells it, and neither is commanded."""

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from deployment_field import TEAM, Field, patrol

from fame.cli import robots
from fame.cli.fleet import doctor
from fame.deploy import STRING, EngineNode, Report
from fame.deploy.authentication import GONE, ReportReader
from fame.deploy.status import StatusPublisher
from fame.errors import FameError
from fame.fleet.diagnostics import WARN, diagnostic_status
from fame.middleware import messages
from fame.middleware.interface import LATCHED

ELDER, YOUNGER = 10.0, 11.0


def engine(field: Field, born: float, notes: list | None = None) -> EngineNode:
    return field.add("p", wall_time=lambda: born, on_report=(notes if notes is not None else []).append)


def whole_again(notes: list | None = None) -> tuple[Field, EngineNode, EngineNode]:
    """The younger engine has a mission, the elder none; they did not hear each other before."""
    field = Field()
    field.listen("p")
    younger = engine(field, YOUNGER, notes)
    field.send("p", patrol(1))
    field.pass_time(2)
    elder = engine(field, ELDER, notes)
    field.pass_time(2)
    return field, younger, elder


def last(field: Field, one: EngineNode) -> Report:
    return [report for report in field.said if report.born == one.born][-1]


def test_both_engines_warn_of_each_other_in_every_report_until_one_is_gone() -> None:
    notes: list = []
    field, younger, elder = whole_again(notes)
    texts = {
        younger: "an older engine has the name 'p'; this one continues, because it runs a process",
        elder: "another engine has the name 'p'; this one continues, because it is older",
    }
    for one, text in texts.items():
        report = last(field, one)
        assert report.warnings == [text]
        assert diagnostic_status(report)["level"] == WARN
    field.pass_time(10)
    assert sorted(note.detail for note in notes if "has the name" in note.detail) == sorted(texts.values())  # once each
    elder.close()
    field.pass_time(GONE + 2)
    assert last(field, younger).warnings == []


def test_neither_takes_a_deployment_before_the_other_is_gone() -> None:
    field, younger, elder = whole_again()
    before = younger.deployed
    for number in range(2):
        assert field.deploy(patrol(2), f"d{number}", number + 1, robots=["p"]).failed
    field.send("p", patrol(3))
    field.pass_time(2)
    assert (younger.deployed, elder.running) == (before, None)
    assert "another engine has the name 'p': end one of them" in [report.reason for report in field.said]
    elder.close()
    field.pass_time(GONE + 2)
    assert not field.deploy(patrol(2), "d9", 9, robots=["p"]).failed


def test_a_second_engine_that_leaves_at_once_is_no_cause_to_warn_or_refuse() -> None:
    field = Field()
    field.listen("p")
    elder = engine(field, ELDER)
    field.pass_time(1)
    younger = engine(field, YOUNGER)
    with pytest.raises(FameError, match="there is an engine 'p' already"):
        field.pass_time(1)
    younger.close()
    assert not field.deploy(patrol(1), robots=["p"]).failed
    assert last(field, elder).warnings == []
    assert not any("has the name" in text for report in field.said for text in report.warnings)


def test_an_engine_that_was_started_anew_is_no_rival() -> None:
    field = Field()
    field.listen("p")
    engine(field, ELDER).close()
    younger = engine(field, YOUNGER)
    assert not field.deploy(patrol(1), robots=["p"]).failed
    assert last(field, younger).warnings == []


@pytest.mark.parametrize(
    ("born", "rival"), [((1, 2), False), ((1, 1, 2, 2), False), ((2, 1), True), ((1, 2, 1), True), ((2, 0), False)]
)
def test_a_reader_without_keys_knows_a_rival_by_an_older_engine_that_speaks_after_a_younger_one(
    born: tuple[int, ...], rival: bool
) -> None:
    reader = ReportReader("A", signed=False)
    for number in born:
        assert reader.read(Report(robot="A", state="waiting", born=number).to_json()) is not None
    assert reader.rival is rival


def test_a_sender_without_keys_sends_nothing_to_two_engines_of_one_name() -> None:
    field = Field("A")
    for born in (6, 5):
        end = field.middleware.node("engine").publisher("/B/bpmn_status", STRING, LATCHED)
        end.publish(messages.create(STRING, Report(robot="B", state="waiting", born=born).to_json()))
    sent = field.deploy(TEAM, robots=["A", "B"])
    assert sent.failed
    assert "two engines say that they are B" in sent.robots["B"].reason
    assert field.engines["A"].running is None


@pytest.mark.parametrize("order", [(ELDER, YOUNGER), (YOUNGER, ELDER)])
def test_status_and_doctor_tell_that_there_are_two(
    order: tuple[float, float], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    field = Field()
    field.listen("p")
    monkeypatch.setattr(StatusPublisher, "_on_own_status", lambda self, message: None)  # they do not hear each other
    for born in order:
        engine(field, born)
        field.pass_time(0.3)

    @contextmanager
    def connected(arguments: Namespace) -> Iterator[tuple]:
        yield field.scheduler, field.middleware

    monkeypatch.setattr(robots, "connected", connected)
    arguments = Namespace(why=None, trust=[], json=False, network=None, robots=["p"], wait=1.0)
    robots.run_status(arguments)
    assert "warning: two engines have this name" in capsys.readouterr().out
    robots.run_status(Namespace(**vars(arguments) | {"json": True}))
    assert '"rivals": [\n    "p"\n  ]' in capsys.readouterr().out
    found = list(doctor._Team(arguments, field.scheduler, field.middleware).findings())
    assert ("wrong", "two engines have this name") in [(each.verdict, each.text) for each in found]
