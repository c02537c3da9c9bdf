"""A team goes over to another model: all robots or none, previewed, and only if nobody would then wait forever."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from deployment_field import TEAM, Field, definitions, made, process
from test_resumption import Durable

from fame.bpmn.library import Library
from fame.bpmn.reader import read_text
from fame.cli import parser
from fame.cli.migration import Migration
from fame.config.loader import read_document
from fame.deploy.migration import read_plan, write_plan
from fame.deploy.sender_protocol import HOLDING
from fame.errors import ConfigError, UnavailableError
from fame.scenario.explore import exploration
from fame.scenario.explore.exploration import explore_migrated


def team(first: str, *, extra: str = "") -> str:
    """Two robots, each at a task; B also listens for a signal of A."""
    pools = "".join(f'<participant id="{r}" name="{r}" processRef="p{r.lower()}"/>' for r in "AB")

    def pool(robot: str, first: str) -> str:
        content = f'<startEvent id="s{robot}"/><scriptTask id="k{robot}"><script>n = 1</script></scriptTask>'
        content += f'<userTask id="{first}" name="First"/><userTask id="{first}2"/>'
        flows = [(f"s{robot}", f"k{robot}"), (f"k{robot}", first), (first, f"{first}2")]
        return process(f"p{robot.lower()}", content, *flows)

    return definitions(f'<collaboration id="C">{pools}</collaboration>', pool("A", first), pool("B", "ub"), extra)


def waiting(field: Field) -> list[list[str]]:
    return [field.engines[robot].running.instances[0].waiting for robot in "AB"]


# ---- a preview -------------------------------------------------------------------------------------------------------


def test_a_preview_tells_what_would_become_of_every_token_and_changes_nothing() -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    sent = field.deploy(team("ux"), "d2", 2, migrate=True, preview=True)
    assert {robot: each.state for robot, each in sent.robots.items()} == {"A": "previewed", "B": "previewed"}
    (blocked,), (kept,) = sent.foreseen["A"].tokens, sent.foreseen["B"].tokens
    assert str(blocked) == '"First" (ua): the new model has no element ua'
    assert blocked.others == ("ux", "ux2")
    assert str(kept) == '"First" (ub): keep'
    assert sent.foreseen["A"].hash == field.engines["A"].hash
    assert [field.engines[robot].deployed for robot in "AB"] == ["d1", "d1"]
    assert [field.engines[robot].running.engine.held for robot in "AB"] == [None, None]
    assert waiting(field) == [["ua"], ["ub"]]


def test_a_preview_of_a_robot_that_runs_nothing_says_so() -> None:
    field = Field("A", "B")
    sent = field.deploy(team("ua"), migrate=True, preview=True)
    assert str(sent.robots["A"]) == "A: previewed: it runs nothing, and would start the model"
    assert field.engines["A"].state == "waiting"


def test_a_repeated_dry_run_keeps_the_plan_and_its_exit_code(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    field = Field("A", "B")
    field.deploy(team("ua"))
    sent = field.deploy(team("ux"), "d2", 2, migrate=True, preview=True)
    assert asked(tmp_path, team("ux"), "--dry-run").show(sent) == 1
    Path("team.plan.yaml").write_text("elements: {}  # edited")
    assert asked(tmp_path, team("ux"), "--dry-run").show(sent) == 1
    assert "team.plan.yaml is kept as it is" in capsys.readouterr().err
    assert Path("team.plan.yaml").read_text() == "elements: {}  # edited"


def test_a_dry_run_says_of_a_robot_at_rest_that_it_takes_the_model(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    field, ended = Field("A", "B"), team("ua").replace("userTask", "task")
    field.deploy(ended)
    sent = field.deploy(ended, "d2", 2, migrate=True, preview=True)
    assert asked(tmp_path, ended, "--dry-run").show(sent) == 0
    assert [line.split()[2:] for line in capsys.readouterr().out.splitlines()[1:]] == [
        ["takes", "the", "model", "nothing", "runs"]
    ] * 2


def test_a_preview_writes_a_plan_that_can_be_used_as_it_is_where_the_choice_is_clear(tmp_path: Path) -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    new = team("ux").replace('<userTask id="ux2"/>', '<manualTask id="ux2"/>')
    sent = field.deploy(new, "d2", 2, migrate=True, preview=True)
    path = tmp_path / "new.plan.yaml"
    write_plan(path, sent.foreseen)
    assert read_plan(path)["elements"] == {"ua": {"to": "ux"}, "ub": "keep"}
    assert "blocked: the new model has no element ua" in path.read_text()
    with pytest.raises(ConfigError, match="exists already"):
        write_plan(path, sent.foreseen)
    sent = field.deploy(new, "d3", 3, migrate=True, plan=read_plan(path))
    assert waiting(field) == [["ux"], ["ub"]]


def test_where_the_choice_is_not_clear_the_plan_has_it_as_a_comment(tmp_path: Path) -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    sent = field.deploy(team("ux"), "d2", 2, migrate=True, preview=True)
    path = tmp_path / "new.plan.yaml"
    write_plan(path, sent.foreseen)
    assert '# "ua": {to: ux, ux2}  # or restart, abandon' in path.read_text()
    assert read_document(path).data["elements"] == {"ub": "keep"}


# ---- who, and what was changed ---------------------------------------------------------------------------------------


def test_the_log_says_who_changed_what_from_which_model_to_which() -> None:
    field = Field("A", "B")
    said: list[Any] = []
    field.engines["A"]._options = replace(field.engines["A"]._options, observer=said.append)
    field.deploy(team("ua"))
    before = field.engines["A"].hash[:12]
    field.deploy(team("ua", extra="<!-- changed -->").replace("n = 1", "n = 2"), "d2", 2, migrate=True, who="ann@desk")
    after = field.engines["A"].hash[:12]
    assert before != after
    reports = [event.detail for event in said if event.what == "report"]
    assert f'migrated from model {before} to {after} by ann@desk (unverified): "First" (ua): keep' in reports


# ---- approval --------------------------------------------------------------------------------------------------------


def relay(wait: str, *, more: str = "") -> str:
    """A throws a signal, then has a task; B waits for a signal."""
    pools = "".join(f'<participant id="{r}" name="{r}" processRef="p{r.lower()}"/>' for r in "AB")
    return definitions(
        f'<signal id="S" name="go"/><signal id="T" name="other"/><collaboration id="C">{pools}</collaboration>',
        process(
            "pa",
            '<startEvent id="sa"/><userTask id="ua"/><intermediateThrowEvent id="throw">'
            '<signalEventDefinition signalRef="S"/></intermediateThrowEvent><endEvent id="ea"/>',
            ("sa", "ua"), ("ua", "throw"), ("throw", "ea"),
        ),
        process(
            "pb",
            '<startEvent id="sb"/><intermediateCatchEvent id="c">'
            f'<signalEventDefinition signalRef="{wait}"/></intermediateCatchEvent><endEvent id="eb"/>{more}',
            ("sb", "c"), ("c", "eb"),
        ),
    )  # fmt: skip


EARLY = (
    relay("T")
    .replace(
        '<endEvent id="ea"/>',
        '<intermediateThrowEvent id="x"><signalEventDefinition signalRef="T"/></intermediateThrowEvent>'
        '<endEvent id="ea"/>',
    )
    .replace('sourceRef="sa" targetRef="ua"', 'sourceRef="sa" targetRef="x"')
    .replace("</process>", '<sequenceFlow id="more" sourceRef="x" targetRef="ua"/></process>', 1)
)
"""B waits for another signal, which A throws before its task: too late for robots that are there."""


def explored(text: str, **options: Any) -> dict[str, Any]:
    """What a deployment is given so that the migrated state is explored; `found` has the result."""
    found: list[Any] = []

    def approve(pools: Any, foreseen: Any) -> str:
        result = explore_migrated(read_text(text, file="team.bpmn"), Library(), pools, foreseen, seconds=20)
        found.append(result)
        return next((one.text for one in result.findings if one.level == "error"), "")

    return {"approve": approve, "found": found, **options}


def test_a_migration_after_which_a_robot_would_wait_for_ever_is_refused_with_the_run_that_shows_it() -> None:
    field = Field("A", "B")
    field.deploy(relay("S"))
    options = explored(EARLY)
    found = options.pop("found")
    sent = field.deploy(EARLY, "d2", 2, migrate=True, **options)
    assert sent.failed
    assert [field.engines[robot].deployed for robot in "AB"] == ["d1", "d1"]
    (finding,) = [one for one in found[0].findings if one.level == "error"]
    assert finding.kind == "deadlock"
    assert "/other" in finding.text
    assert next(step.element for step in finding.run) == "ua"
    assert finding.text in str(sent.robots["A"])
    field.engines["A"].running.complete("ua")
    field.pass_time(1)
    assert [field.engines[robot].running.completed for robot in "AB"] == [1, 1]


def asked(folder: Path, text: str, *words: str) -> Migration:
    """What ``fame deploy --migrate`` asks for."""
    model = folder / "team.bpmn"
    model.write_text(text)
    arguments = parser().parse_args(["deploy", str(model), "--migrate", *words])
    return Migration(arguments, read_text(text, file=str(model)), Library())


@pytest.mark.parametrize(
    ("elements", "said"),
    [
        ("ubb: restart", r"p.yaml:2: elements.ubb: no robot runs a model with this element; did you mean 'ub'?"),
        ("ua: {to: uz9}", r"p.yaml:2: elements.ua.to: the new model has no element uz9; did you mean 'uz2'?"),
    ],
)
def test_a_plan_that_names_what_is_not_there_is_refused_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, elements: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    changed = team("ua").replace("ua2", "uz2")
    field = Field("A", "B")
    field.deploy(team("ua"))
    Path("p.yaml").write_text(f"elements:\n  {elements}\n  ub: keep\n")
    dry = asked(tmp_path, changed, "--dry-run", "--plan", "p.yaml")
    with pytest.raises(ConfigError, match=re.escape(said)):
        dry.show(field.deploy(changed, "d2", 2, options=dry.options))
    if "to" not in elements:  # else the robot has refused it already
        refused = asked(tmp_path, changed, "--plan", "p.yaml", "--force")
        sent = field.deploy(changed, "d3", 3, options=refused.options)
        assert said in str(sent.robots["A"])
        assert refused.exit_code(sent) == 2
    assert [field.engines[robot].deployed for robot in "AB"] == ["d1", "d1"]


def test_a_plan_that_renames_a_variable_that_no_robot_has_gets_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    field = Field("A", "B")
    field.deploy(team("ua").replace("<script>n = 1", "<script>speed = 1", 1))
    Path("p.yaml").write_text("variables:\n  n: {rename: m}\n  sped: {rename: v}\n")
    for number, options in enumerate((["--dry-run"], [])):
        given = asked(tmp_path, team("ua"), *options, "--plan", "p.yaml")
        sent = field.deploy(team("ua"), f"d{number + 2}", number + 2, options=given.options)
        assert (given.show(sent) if options else given.exit_code(sent)) == 0
        said = capsys.readouterr().err
        assert "warning: p.yaml:3: variables.sped: no robot has this variable; did you mean 'speed'?" in said
        assert "variables.n" not in said


def test_a_plan_may_name_elements_of_any_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    field = Field("A", "B")
    field.deploy(team("ua"))
    Path("p.yaml").write_text("elements:\n  ua: {to: ua}\n  ub: restart\n  sA: keep\n")
    asking = asked(tmp_path, team("ua"), "--plan", "p.yaml")
    sent = field.deploy(team("ua"), "d2", 2, options=asking.options)
    assert (asking.exit_code(sent), waiting(field)) == (0, [["ua"], ["ub"]])


def test_force_overrides_what_the_exploration_finds_and_the_logs_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    field = Field("A", "B")
    said: list[Any] = []
    field.engines["B"]._options = replace(field.engines["B"]._options, observer=said.append)
    field.deploy(relay("S"))
    refused = asked(tmp_path, EARLY)
    sent = field.deploy(EARLY, "d2", 2, options=refused.options)
    assert sent.failed
    assert "(--force overrides)" in str(sent.robots["A"])
    assert {each.state for each in sent.robots.values()} == {"refused"}
    refused.explain(sent)
    run = capsys.readouterr().err
    assert "the migration is refused: all robots continue with what they had" in run
    assert "error in the migrated state: " in run
    assert "ua" in run.partition("error in the migrated state: ")[2]
    forced = asked(tmp_path, EARLY, "--force")
    sent = field.deploy(EARLY, "d3", 3, who="ann@desk", options=forced.options)
    assert not sent.failed
    assert [field.engines[robot].deployed for robot in "AB"] == ["d3", "d3"]
    assert f"overridden by --force: {forced.findings()[0]['text']}" in capsys.readouterr().err
    reports = [event.detail for event in said if event.what == "report"]
    assert any("by ann@desk (unverified), whatever the exploration finds (--force)" in text for text in reports)


def test_force_says_what_could_not_be_explored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unable(*_: object, **__: object) -> None:
        raise UnavailableError("the room explore is not installed")

    monkeypatch.setattr("fame.cli.migration.load", lambda place: unable)
    assert asked(tmp_path, EARLY)._approve({}, {}) == "the room explore is not installed (--force overrides)"
    assert asked(tmp_path, EARLY, "--force")._approve({}, {}) == ""
    assert "overridden by --force: the room explore is not installed" in capsys.readouterr().err


def test_a_migration_that_is_not_explored_whole_is_not_known_to_be_fine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    field = Field("A", "B")
    field.deploy(relay("S"))
    monkeypatch.setattr(exploration, "BUDGET", 1e-9)
    for number, (options, code, status) in enumerate((((), 3, "partial"), (("--allow-partial",), 0, "completed")), 2):
        given = asked(tmp_path, relay("S"), *options)
        sent = field.deploy(relay("S"), f"d{number}", number, options=given.options)
        assert (given.exit_code(sent), given.status(sent)) == (code, status)
    refused = asked(tmp_path, relay("S"))
    sent = field.deploy(relay("S"), "d4", 4, options=refused.options)
    assert "no error found in a partial search" in str(sent.robots["A"])


def test_who_begins_in_a_migration_and_waits_for_what_may_have_been_thrown_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    field = Field("A", "B")
    field.deploy(TEAM.replace('<participant id="B" name="B" processRef="pb"/>', ""))
    given = asked(tmp_path, TEAM)
    sent = field.deploy(TEAM, "d2", 2, options=given.options)
    assert not sent.failed, sent.robots
    given.explain(sent)
    assert "warning: B waits for /go to start, which A may have thrown already" in capsys.readouterr().err


def test_what_is_armed_anew_is_said_by_the_dry_run_and_by_the_answer(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)

    def timed(trigger: str) -> str:
        event = f'<boundaryEvent id="b" attachedToRef="ub" cancelActivity="false">{trigger}</boundaryEvent>'
        return team("ua").replace('<userTask id="ub2"/>', f'<userTask id="ub2"/>{event}')

    field = Field("A", "B")
    field.deploy(timed("<timerEventDefinition><timeDuration>PT9S</timeDuration></timerEventDefinition>"))
    changed = timed("<conditionalEventDefinition><condition>n &gt; 7</condition></conditionalEventDefinition>")
    sent = field.deploy(changed, "d2", 2, migrate=True, preview=True)
    assert asked(tmp_path, changed, "--dry-run").show(sent) == 0
    assert '"First" (ub)  keep     arms b anew' in capsys.readouterr().out
    given = asked(tmp_path, changed)
    given.explain(field.deploy(changed, "d3", 3, options=given.options))
    assert 'B: "First" (ub): keep (arms b anew)' in capsys.readouterr().err


def test_a_migration_that_may_complete_is_approved() -> None:
    field = Field("A", "B")
    field.deploy(relay("S"))
    new = (
        relay("S")
        .replace('<endEvent id="eb"/>', '<userTask id="new"/><endEvent id="eb"/>')
        .replace('targetRef="eb"', 'targetRef="new"')
        .replace(
            "</process></definitions>", '<sequenceFlow id="m" sourceRef="new" targetRef="eb"/></process></definitions>'
        )
    )
    options = explored(new)
    found = options.pop("found")
    sent = field.deploy(new, "d2", 2, migrate=True, **options)
    assert not sent.failed, sent.robots
    assert found[0].exhaustive
    assert waiting(field) == [["ua"], ["c"]]


def test_robots_are_held_for_five_seconds_at_most() -> None:
    """B never answers; A, which is ready, goes on in time."""
    field = Field("A", "B")
    field.deploy(team("ua"))
    field.engines["B"]._process.close()
    sent = made(field, team("ua"), "d2", 2, migrate=True)
    sent.begin()
    held = []
    for _ in range(100):
        field.pass_time(0.1)
        held.append(field.engines["A"].running.engine.held is not None)
    assert sent.failed
    assert 0 < sum(held) * 0.1 <= HOLDING + 0.2 <= 5.0
    assert not held[-1]
    assert "robots would be held for more than" in str(sent.robots["A"])


# ---- one after the other, and robots that die ------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.03, 0.1])
def test_of_two_migrations_at_a_time_one_comes_after_the_other_at_all_robots(delay: float) -> None:
    field = Field("A", "B")
    field.deploy(team("ua"))
    first = made(field, team("ua").replace("n = 1", "n = 2"), "d2", 2, migrate=True)
    second = made(field, team("ua").replace("n = 1", "n = 3"), "d3", 3, migrate=True)
    first.begin()
    field.pass_time(delay)
    second.begin()
    field.pass_time(15)
    assert first.done
    assert second.done
    assert [field.engines[robot].deployed for robot in "AB"] == ["d3", "d3"]
    assert waiting(field) == [["ua"], ["ub"]]
    assert [field.engines[robot].running.instances[0].visits[f"k{robot}"] for robot in "AB"] == [1, 1]


class DurableTeam(Durable):
    """Two robots, of which A has a state directory."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.add("B")
        self.listen("A", "B")


@pytest.fixture
def field(tmp_path: Path) -> Iterator[DurableTeam]:
    made = DurableTeam(tmp_path / "state")
    yield made
    for engine in made.engines.values():
        engine.close()


def dying(field: DurableTeam, answer: str) -> Any:
    """An approval at whose moment, when all are ready and none has started, the engine of A is killed."""

    def approve(pools: Any, foreseen: Any) -> str:
        field.crash()
        return answer

    return approve


def test_a_robot_that_dies_between_ready_and_start_goes_over_with_its_team_when_it_is_back(field: DurableTeam) -> None:
    field.deploy(team("ua"))
    sent = made(field, team("ua").replace("n = 1", "n = 2"), "d2", 2, migrate=True, approve=dying(field, ""))
    sent.begin()
    field.pass_time(0.5)
    assert field.engines["B"].deployed == "d2"
    field.start()
    field.pass_time(12)
    assert field.engines["A"].deployed == "d2"
    assert waiting(field) == [["ua"], ["ub"]]
    assert field.engines["A"].running.instances[0].visits["kA"] == 1
    assert not (field.folder / "promise").exists()


def test_a_robot_that_dies_when_it_is_ready_keeps_what_it_had_if_the_others_do(field: DurableTeam) -> None:
    field.deploy(team("ua"))
    sent = made(field, team("ua").replace("n = 1", "n = 2"), "d2", 2, migrate=True, approve=dying(field, "no"))
    sent.begin()
    field.pass_time(12)
    assert field.engines["B"].deployed == "d1"
    field.start()
    field.pass_time(20)
    assert field.engines["A"].deployed == "d1"
    assert waiting(field) == [["ua"], ["ub"]]
    assert [field.engines[robot].state for robot in "AB"] == ["running", "running"]


# ---- parts of models -------------------------------------------------------------------------------------------------


def called(task: str) -> str:
    return definitions(
        process(
            "cut",
            f'<startEvent id="cs"/><scriptTask id="ck"><script>done = 1</script></scriptTask><userTask id="{task}"/>'
            '<userTask id="after"/>',
            ("cs", "ck"), ("ck", task), (task, "after"),
        )
    )  # fmt: skip


def caller(call: str) -> str:
    pools = "".join(f'<participant id="{r}" name="{r}" processRef="p{r.lower()}"/>' for r in "AB")
    return definitions(
        f'<collaboration id="C">{pools}</collaboration>',
        process("pa", f'<startEvent id="sa"/><callActivity id="{call}" calledElement="cut"/>', ("sa", call)),
        process("pb", '<startEvent id="sb"/><userTask id="ub"/>', ("sb", "ub")),
    )


def test_tokens_in_called_processes_of_split_models_go_over_by_their_ids(tmp_path: Path) -> None:
    field = Field("A", "B")
    old, new = tmp_path / "old", tmp_path / "new"
    for folder, task in ((old, "mow"), (new, "cut_grass")):
        folder.mkdir()
        (folder / "cut.bpmn").write_text(called(task))
    field.deploy(caller("call"), library=Library([old]))
    assert waiting(field) == [["mow"], ["ub"]]
    plan = {"elements": {"call": {"to": "call_2"}, "mow": {"to": "cut_grass"}}}
    library = Library([new])
    text = caller("call_2")

    def approve(pools: Any, foreseen: Any) -> str:
        result = explore_migrated(read_text(text, file="team.bpmn"), library, pools, foreseen, seconds=20)
        return next((one.text for one in result.findings if one.level == "error"), "")

    sent = field.deploy(text, "d2", 2, migrate=True, plan=plan, library=library, approve=approve)
    assert not sent.failed, sent.robots
    assert waiting(field) == [["cut_grass"], ["ub"]]
    (instance,) = field.engines["A"].running.instances
    assert instance.visits["ck"] == 1
    field.engines["A"].running.complete("cut_grass")
    assert waiting(field) == [["after"], ["ub"]]
