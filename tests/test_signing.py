"""A robot that trusts keys runs what they signed, for it, now, and nothing else."""

import json
import os
import stat
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("cryptography", reason="cryptography is not installed: pip install 'fame-robots[dds]'")

from deployment_field import TEAM, Field, definitions, made, patrol, process

import fame
from fame.cli import main
from fame.deploy import STRING
from fame.deploy.authentication import ReportReader
from fame.deploy.fields import values
from fame.deploy.request_verifier import RequestVerifier
from fame.deploy.requests import TaskClient, TaskRequest
from fame.deploy.signing import FRESH, Identity, new_keys, read_private, read_trusted, sign, verify
from fame.errors import ConfigError
from fame.middleware import messages

NOW = 1_000_000.0


@pytest.fixture
def keys(tmp_path):
    secret, public = new_keys(tmp_path / "team")
    return read_private(secret), read_trusted([public])


class Guarded(Field):
    """Robots that trust a key."""

    def __init__(self, trusted, *robots: str) -> None:
        super().__init__(*robots, trusted=trusted, wall_time=lambda: NOW)


def test_what_a_trusted_key_signed_is_run(keys):
    field = Guarded(keys[1], "A", "B")
    sent = field.deploy(TEAM, key=keys[0], wall_time=lambda: NOW)
    assert not sent.failed
    assert field.engines["A"].state == "running"


def test_what_nobody_signed_is_refused(keys):
    field = Guarded(keys[1], "A", "B")
    sent = field.deploy(TEAM)
    assert sent.failed
    assert any("not signed" in standing.reason for standing in sent.robots.values())
    field.send("A", patrol(1))
    field.pass_time(0.1)
    assert "not signed" in [report.reason for report in field.said if report.answer == "refused"][-1]
    assert field.engines["A"].running is None


def test_who_takes_a_robot_over_has_a_lease_that_is_signed(keys):
    field = Guarded(keys[1], "A", "B")
    field.deploy(TEAM, key=keys[0], wall_time=lambda: NOW)
    for number, (key, suspended) in enumerate(((None, False), (keys[0], True))):
        request = TaskRequest(id=f"r{number}", element="", act="take_over", lease="l", who="eve")
        ends = {"node": field.person, "scheduler": field.scheduler, "answered": lambda report: None}
        asking = TaskClient("A", request, key=key, wall_time=lambda: NOW, **ends)
        field.pass_time(1.5)
        asking.close()
        assert bool(field.engines["A"].running.suspension.holder) is suspended


def test_the_bytes_of_a_signed_request_do_nothing_when_they_are_sent_again_as_long_as_they_are_fresh(keys):
    field = Guarded(keys[1], "A", "B")
    field.deploy(TEAM, key=keys[0], wall_time=lambda: NOW)
    engine, out = field.engines["A"], field.person.publisher("/A/bpmn_task", STRING)

    def ask(id: str, **request) -> str:
        made = TaskRequest(id=id, element="", **request).signed("A", keys[0], born=engine.born, now=NOW)
        return send(made.to_json())

    def send(text: str) -> str:
        out.publish(messages.create(STRING, text))
        field.pass_time(0.01)
        return text

    ask("suspended", act="suspend")
    recorded = ask("recorded", act="continue")
    for number in range(150):
        ask(f"{number}", act="note", to="on my way")
    ask("again", act="suspend")
    send(recorded)
    assert (field.said[-1].answer, field.said[-1].deployment) == ("continued", "recorded")
    assert engine.state == "suspended"
    field.pass_time(2 * FRESH)
    ask("much later", act="note", to="there")
    assert len(engine._tasks._answers) < 110


@pytest.mark.parametrize("signed", [("A", 5, NOW), ("B", 5, NOW), ("A", 4, NOW), ("A", 5, NOW - 86_400)])
def test_where_tasks_need_not_be_signed_a_replayed_signature_names_nobody(keys, signed):
    verifier = RequestVerifier("A", 5, keys[1], lambda: NOW, unsigned_tasks=True)
    robot, born, now = signed
    signer = verifier.verify_task(TaskRequest(id="r", element="t").signed(robot, keys[0], born=born, now=now))
    assert bool(signer) is (signed == ("A", 5, NOW))
    assert verifier.verify_task(TaskRequest(id="r", element="t")) == ""


def test_a_key_that_is_not_trusted_does_not_count(keys, tmp_path):
    stranger = read_private(new_keys(tmp_path / "stranger")[0])
    field = Guarded(keys[1], "A", "B")
    field.deploy(TEAM, key=stranger, wall_time=lambda: NOW)
    assert any("trusts" in report.reason for report in field.said)
    assert field.engines["A"].running is None


@pytest.mark.parametrize("phase", ["load", "hold", "start", "abort"])
def test_what_a_stranger_says_of_a_deployment_that_is_known_is_no_answer_to_its_sender(keys, phase):
    field = Guarded(keys[1], "A", "B")
    sent = field.deploy(TEAM, key=keys[0], wall_time=lambda: NOW)
    field.send("A", replace(sent.envelopes["A"], phase=phase, signature="").to_json())
    field.pass_time(0.1)
    refusal = [report for report in field.said if report.answer == "refused"][-1]
    assert refusal.deployment == ""
    assert "not signed" in refusal.reason
    assert (field.engines["A"].deployed, field.engines["A"].state) == ("d1", "running")


def test_an_old_signature_and_a_changed_envelope_are_refused(keys):
    said = {"deployment": "d", "hash": "h", "robot": "A", "issued": NOW, "model": "x"}
    signed = said | {"signature": sign(said, keys[0])}
    verify(signed, keys[1], NOW + FRESH)
    verify(signed | {"model": "its hash stands for it"}, keys[1], NOW)
    with pytest.raises(fame.DeploymentError, match="301 s ago"):
        verify(signed, keys[1], NOW + FRESH + 1)
    for change in ({"robot": "B"}, {"hash": "g"}, {"issued": NOW + 9}):
        with pytest.raises(fame.DeploymentError, match="trusts"):
            verify(signed | change, keys[1], NOW)


def test_a_replayed_envelope_of_another_robot_is_refused(keys):
    field = Guarded(keys[1], "A", "B")
    sent = field.deploy(TEAM, key=keys[0], wall_time=lambda: NOW)
    envelope = replace(sent.envelopes["A"], issued=NOW)
    field.send("B", replace(envelope, signature=sign(values(envelope), keys[0])).to_json())
    field.pass_time(0.1)
    assert "meant for robot 'A'" in field.said[-1].reason


def test_what_was_recorded_is_no_use_when_the_engine_begins_anew(keys):
    field = Guarded(keys[1], "A", "B")
    heard = []
    field.person.subscription("/A/bpmn_process", STRING, heard.append)
    field.deploy(TEAM, key=keys[0], wall_time=lambda: NOW)
    assert field.engines["A"].deployed == "d1"
    field.engines["A"].close()
    engine = field.add("A", trusted=keys[1], wall_time=lambda: NOW + 20)
    field.said.clear()
    for message in heard:
        field.send("A", message.data)
    field.pass_time(1)
    assert [report.answer for report in field.said if report.answer] == ["refused"] * len(heard)
    assert any("replay" in report.reason for report in field.said)
    assert engine.state == "waiting"


def test_no_word_of_the_protocol_counts_that_was_not_signed(keys):
    field = Guarded(keys[1], "A")
    sent = made(field, TEAM.replace('name="go"', 'name="~/go"'), "d1", 1)
    engine = field.engines["A"]
    envelope = replace(sent.envelopes["A"], issued=NOW, born=engine.born)
    field.send("A", replace(envelope, signature=sign(values(envelope), keys[0])).to_json())
    field.pass_time(0.1)
    assert engine.state == "ready"
    for phase in ("start", "abort", "hold"):
        field.send("A", sent._envelope("A", phase).to_json())
        field.pass_time(0.1)
        assert ("not signed" in field.said[-1].reason, engine.state) == (True, "ready")


def test_a_secret_key_is_for_its_owner_alone_and_never_overwritten(tmp_path):
    secret, _ = new_keys(tmp_path / "k")
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    with pytest.raises(fame.ConfigError, match="never overwritten"):
        new_keys(tmp_path / "k")
    broken = tmp_path / "broken.pub"
    broken.write_text(json.dumps("no key"))
    with pytest.raises(fame.ConfigError, match=r"broken\.pub.*PEM"):
        read_trusted([broken])


def test_a_secret_key_that_others_can_read_is_refused(tmp_path):
    secret, _ = new_keys(tmp_path / "k")
    secret.chmod(0o640)
    with pytest.raises(fame.ConfigError, match=r"k\.key: others can read it.*chmod 600"):
        read_private(secret)


def test_the_public_key_in_place_of_the_secret_one_is_named_so(tmp_path):
    _, public = new_keys(tmp_path / "k")
    with pytest.raises(fame.ConfigError, match=r"k\.pub: is the public key, .*; expected the private one"):
        read_private(public)


def test_a_file_of_trust_may_have_comments_several_keys_and_the_line_ends_of_windows(tmp_path):
    pairs = [new_keys(tmp_path / name) for name in ("ann", "bob")]
    texts = [f"# {public.stem}\n{public.read_text()}\n" for _, public in pairs]
    both = tmp_path / "both.pub"
    both.write_bytes("".join(texts).replace("\n", "\r\n").encode())
    said = {"deployment": "d", "issued": NOW}
    for secret, _ in pairs:
        verify(said | {"signature": sign(said, read_private(secret))}, read_trusted([both]), NOW)


P224 = """-----BEGIN PUBLIC KEY-----
ME4wEAYHKoZIzj0CAQYFK4EEACEDOgAEkNzLpvx0tFGZVNkHjpyCxOSVtWxtzvRDoXEwcPpoC5Ep
uXJAKXIW5dmVJQT2pdVo3xZlMcrvTYo=
-----END PUBLIC KEY-----
"""


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text[:60],
        lambda text: text[:-10],
        lambda text: "",
        lambda text: text + text[:40],
        lambda text: text.replace("MC", "MD"),
        lambda text: P224,
        lambda text: "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIB me@here",
    ],
    ids=["head", "no tail", "empty", "one and a half", "changed", "another kind", "of ssh"],
)
def test_a_file_that_is_not_wholly_of_keys_is_refused(tmp_path, change):
    _, public = new_keys(tmp_path / "k")
    public.write_text(change(public.read_text()))
    with pytest.raises(fame.ConfigError, match=r"k\.pub"):
        read_trusted([public])


def test_an_engine_on_an_open_network_wants_a_key_or_to_be_told_that_it_needs_none(capsys):
    assert main(["engine", "A", "--network", "lo"]) == 2
    assert "--trust FILE.pub, or --insecure" in capsys.readouterr().err


@pytest.mark.dds
def test_so_does_one_on_loopback_that_the_platform_does_not_confine(monkeypatch, capsys):
    pytest.importorskip("cyclonedds")
    from fame.middleware.dds import domain

    monkeypatch.setattr(domain, "bind_to_loopback", lambda number: False)
    monkeypatch.setenv("ROS_DOMAIN_ID", "229")
    assert main(["engine", "A"]) == 2
    assert "others can reach this process" in capsys.readouterr().err


@pytest.mark.parametrize("depth", [33, 200, 600, 100_000])
@pytest.mark.parametrize("kind", ["plan", "proof", "values"])
def test_unsigned_json_of_any_depth_is_refused_and_the_engine_goes_on(keys, kind, depth):
    field = Guarded(keys[1], "A")
    envelope = '{"fame":1,"deployment":"d9","sequence":9,"robot":"A","phase":"%s","%s":{"x":%s}}'
    request = '{"id":"d9","element":"x","values":{"x":%s}}'
    deep = "[" * depth + "]" * depth
    task = field.person.publisher("/A/bpmn_task", STRING)
    if kind == "values":
        task.publish(messages.create(STRING, request % deep))
    else:
        field.send("A", envelope % ("ask" if kind == "proof" else "load", kind, deep))
    field.pass_time(0.1)
    assert field.said[-1].answer == "refused"
    assert "nested" in field.said[-1].reason
    assert field.deploy(
        definitions(process("A", '<startEvent id="s"/>')), key=keys[0], robots=["A"], wall_time=lambda: NOW
    ).done


@pytest.mark.parametrize("depth", [200, 600])
def test_a_report_of_any_depth_is_ignored_by_who_uses_keys(keys, depth):
    deep = "[" * depth + "]" * depth
    text = '{"robot":"A","state":"waiting","key":"%s","signature":"AAAA","migration":{"state":{"x":%s}}}'
    reader = ReportReader.of_sender("A", keys[0])
    assert reader.read(text % (Identity.new().key, deep)) is None


def test_keys_follow_no_link_that_leads_nowhere_and_no_umask(tmp_path: Path) -> None:
    (tmp_path / "team.key").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="exists already"):
        new_keys(tmp_path / "team")
    assert not (tmp_path / "elsewhere").exists()
    before = os.umask(0)
    try:
        paths = new_keys(tmp_path / "other")
    finally:
        os.umask(before)
    assert [path.stat().st_mode & 0o777 for path in paths] == [0o600, 0o644]
