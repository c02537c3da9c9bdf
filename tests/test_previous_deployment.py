"""Robots keep what they ran, and start it again when asked: all or none, signed, without the file."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from deployment_field import TEAM, Field, patrol

from fame.cli import main
from fame.cli.deployment import _roll_back
from fame.cli.fleet.inventory import item
from fame.deploy import Deployment, Envelope, Report
from fame.deploy.history import KEPT, History
from fame.deploy.options import DeploymentOptions
from fame.errors import DeploymentError
from fame.robot.journal import StateDirectory
from fame.scenario.deployment import deploy_previous


def said(field: Field, robot: str) -> Mapping[str, Any]:
    """What a robot says of what it ran before."""
    field.pass_time(2)
    return next(report for report in reversed(field.said) if report.robot == robot and report.said).said["previous"]


def back(field: Field, *robots: str, **options: Any) -> Deployment:
    """Deploy what robots ran before."""
    return recalled(field, {robot: said(field, robot) for robot in robots}, **options)


def recalled(
    field: Field, previous: Mapping[str, Any], id: str = "back", sequence: int = 10, **options: Any
) -> Deployment:
    sent = Deployment(
        previous,
        id=id,
        sequence=sequence,
        scheduler=field.scheduler,
        middleware=field.middleware,
        ended=lambda deployment: None,
        options=replace(DeploymentOptions(), **options),
    )
    sent.begin()
    field.pass_time(12)
    return sent


def only(robot: str, mark: int) -> str:
    return patrol(mark).replace('id="p"', f'id="{robot}"')


OTHER = TEAM.replace('"ua"', '"va"').replace('"ub"', '"vb"')


def test_a_team_goes_back_to_what_it_ran_before_and_forth_again():
    field = Field("A", "B")
    field.deploy(TEAM)
    field.deploy(OTHER, "d2", 2)
    assert {said(field, robot)["deployment"] for robot in "AB"} == {"d1"}
    first = {robot: said(field, robot)["hash"] for robot in "AB"}
    assert not back(field, "A", "B").failed
    assert {robot: engine.hash for robot, engine in field.engines.items()} == first
    assert {said(field, robot)["deployment"] for robot in "AB"} == {"d2"}
    assert not back(field, "A", "B", id="forth", sequence=11).failed
    assert all(field.engines[robot].hash != first[robot] for robot in "AB")


def test_if_one_does_not_keep_it_none_goes_back():
    field = Field("A", "B")
    field.deploy(TEAM)
    field.deploy(OTHER, "d2", 2)
    previous = {robot: said(field, robot) for robot in "AB"}
    field.engines["B"]._history = History()
    sent = recalled(field, previous)
    assert sent.failed
    assert sent.robots["B"].reason.startswith("it does not keep model ")
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


def test_a_rollback_that_one_refuses_says_that_none_went_back(capsys: pytest.CaptureFixture[str]):
    field = Field("A", "B")
    field.deploy(TEAM)
    sent = field.deploy(OTHER, "d2", 2)
    field.pass_time(2)
    field.engines["B"]._history = History()
    assert _roll_back(sent, DeploymentOptions(), 5.0, {}).failed
    said = capsys.readouterr().err
    assert "it has not ended within 5 s: back to what ran before" in said
    assert "not rolled back: all run the new process on; fame deploy --previous tries again" in said
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


def test_without_one_of_the_team_that_ran_it_the_others_do_not_go_back():
    field = Field("A", "B")
    field.deploy(TEAM)
    field.deploy(OTHER, "d2", 2)
    field.pass_time(2)
    latest = {report.robot: report for report in field.said if report.said}
    del latest["B"]
    with pytest.raises(DeploymentError, match=r"^B ran d1 too, and cannot go back: not found; name .* with --to"):
        deploy_previous(latest, field.scheduler, field.middleware, DeploymentOptions())
    assert {engine.deployed for engine in field.engines.values()} == {"d2"}


@pytest.mark.parametrize("text", ["", "<definitions/>"])
def test_what_is_not_kept_or_has_a_model_besides_is_refused(text: str):
    envelope = Envelope(deployment="d", sequence=1, robot="A", phase="load", model=text, recalls="0" * 64)
    with pytest.raises(DeploymentError, match="recalls another one" if text else "does not keep model"):
        History().recall(envelope)


def test_without_a_model_before_or_after_different_ones_it_is_said():
    field = Field("A", "B")
    field.deploy(only("A", 1), robots=["A"])
    field.deploy(only("A", 2), "d2", 2, robots=["A"])
    field.deploy(only("B", 1), "d3", 3, robots=["B"])
    field.pass_time(2)
    latest = {report.robot: report for report in field.said if report.said}
    to = field.scheduler, field.middleware, DeploymentOptions()
    with pytest.raises(DeploymentError, match="B ran nothing before, or does not keep it any more"):
        deploy_previous(latest, *to)
    field.deploy(only("B", 2), "d4", 4, robots=["B"])
    field.pass_time(2)
    latest = {report.robot: report for report in field.said if report.said}
    with pytest.raises(DeploymentError, match=r"different deployments before \(A d1, B d3\): name .* with --to"):
        deploy_previous(latest, *to)
    with pytest.raises(DeploymentError, match=r"A runs an older FAME \(protocol 1\)"):
        deploy_previous({"A": Report(robot="A", state="running")}, *to)


def test_a_robot_with_a_state_keeps_the_last_few_over_a_restart(tmp_path: Path):
    field = Field()
    state = StateDirectory(tmp_path / "state")
    field.add("A", state=state)
    field.listen("A")
    for number in range(1, KEPT + 4):
        field.deploy(only("A", number), f"d{number}", number)
    assert len(list((tmp_path / "state").glob("deployment-*"))) == KEPT + 1
    field.engines["A"].stop()
    state.close()
    field.add("A", state=StateDirectory(tmp_path / "state"))
    assert not back(field, "A").failed
    assert field.variables("A") == {"mark": KEPT + 2}
    field.engines["A"].close()


def test_with_keys_it_is_signed_and_what_was_changed_on_the_disk_is_no_previous_one(tmp_path: Path):
    pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'fame-robots[dds]'")
    from fame.deploy.signing import new_keys, read_private, read_trusted

    secret, public = new_keys(tmp_path / "team")
    key, trusted = read_private(secret), read_trusted([public])
    field, folder = Field(), tmp_path / "state"
    state = StateDirectory(folder)
    field.add("A", state=state, trusted=trusted, wall_time=lambda: 1e6)
    field.listen("A")
    signed: dict[str, Any] = {"key": key, "wall_time": lambda: 1e6}
    field.deploy(only("A", 1), **signed)
    field.deploy(only("A", 2), "d2", 2, **signed)
    assert back(field, "A").robots["A"].reason.startswith("not signed")
    assert not back(field, "A", id="b2", sequence=11, **signed).failed
    assert field.variables("A") == {"mark": 1}

    field.engines["A"].stop()
    state.close()
    (ran,) = [path for path in folder.glob("deployment-*") if json.loads(path.read_text())["deployment"] == "d2"]
    ran.write_text(ran.read_text().replace("mark = 2", "mark = 3"))
    field.add("A", state=StateDirectory(folder), trusted=trusted, wall_time=lambda: 1e6)
    assert said(field, "A")["deployment"] == "d1"  # d2 is no previous one any more
    assert (field.engines["A"].deployed, field.variables("A")) == ("b2", {"mark": 1})
    field.engines["A"].close()


def test_what_a_robot_recalls_has_the_promises_that_were_signed():
    kept = Envelope(deployment="d1", sequence=1, robot="A", phase="load", model="m", promises={"/a": "publisher"})
    history = History([kept])
    history.begin(replace(kept, deployment="d2", model="n"))
    asked = replace(kept, deployment="d3", model="", promises={}, recalls=history.previous()["recalls"])
    assert history.recall(asked).promises == kept.promises
    with pytest.raises(DeploymentError, match="does not keep"):
        History([replace(kept, promises={})]).recall(asked)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["deploy"], "expected either MODEL.bpmn or --previous"),
        (["deploy", "x.bpmn", "--previous"], "expected either MODEL.bpmn or --previous"),
        (["deploy", "--previous", "--migrate"], "--migrate cannot be given with --previous"),
        (["deploy", "x.bpmn", "--rollback-unless-ended", "3", "--stay"], "cannot be given with --stay"),
        (["deploy", "x.bpmn", "--rollback-unless-ended", "0"], "--rollback-unless-ended"),
    ],
)
def test_options_that_do_not_fit_are_refused(words: list[str], told: str, capsys: pytest.CaptureFixture[str]):
    assert main(words) == 2
    assert told in capsys.readouterr().err


def test_an_inventory_says_what_is_not_known():
    nothing = item("A", None, None, ())
    assert {name for name, value in nothing.items() if value is not None} == set()
    old = item("A", Report(robot="A", state="running", hash="0" * 64, time=3.0), None, ())
    assert (old["protocol"], old["fame"], old["previous"], old["up"]) == (1, None, None, 3.0)
