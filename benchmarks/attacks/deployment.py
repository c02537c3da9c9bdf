"""Attacks on the deployment: senders that die, robots that fall silent, envelopes and reports that are forged."""

from __future__ import annotations

import json
import signal
import threading
import time
from dataclasses import asdict, replace

from attacks.field import START, TEAM, WAIT, Engine, Field, envelope, held, model, process
from attacks.team import Team
from fame.deploy import STATUS_QOS, STRING, Report
from fame.deploy.envelope import read_envelope, signed
from fame.deploy.signing import read_private

MISSION = model(
    '<collaboration id="c"><participant id="P" name="A" processRef="p"/></collaboration>', process("p", START, WAIT)
)
FUTURE = 2**53 - 1


def _deploys(field: Field, *more: str, text: str = MISSION) -> str:
    """How a deployment ends: empty if it is done, else what was said."""
    done = field.fame("deploy", field.file("mission.bpmn", text), *more)
    return "" if done.returncode == 0 else f"{done.stdout}{done.stderr}".strip() or str(done.returncode)


def _keys(field: Field) -> tuple[str, str]:
    """A secret and a public key."""
    held(field.fame("keys", "new", str(field.folder / "team")).returncode == 0, "no keys")
    return str(field.folder / "team.key"), str(field.folder / "team.pub")


def sender_dies(field: Field) -> None:
    """A sender dies between load and start of a robot that is alone."""
    field.start("A")
    field.say("/A/bpmn_process", envelope("A", "load", "d1", model=MISSION, team=["A"]))
    held(field.answer("A", "ready", 10), "was not ready")
    held(field.answer("A", "aborted", 15), "stays ready forever")
    held(not (text := _deploys(field)), f"the next deployment failed: {text}")


def silent_other(field: Field) -> None:
    """Nobody hears a robot for 12 s that has just started, and its sender dies: the other one must not decide alone."""
    engines = [field.start("A"), field.start("B")]
    for robot, process_of in (("A", "pa"), ("B", "pb")):
        part = model(process(process_of, f'<startEvent id="s{robot}"/>', f'<userTask id="u{robot}"/>'))
        field.say(f"/{robot}/bpmn_process", envelope(robot, "load", "d1", model=part, team=["A", "B"]))
    for robot in ("A", "B"):
        held(field.answer(robot, "ready", 10), f"{robot} was not ready")
    field.say("/A/bpmn_process", envelope("A", "start", "d1"))
    held(field.answer("A", "started", 5), "A did not start")
    engines[0].tell(signal.SIGSTOP)
    try:
        decided = field.until(lambda: field.reports["B"] and field.last("B").state not in ("ready", "holding"), 12)
        held(not decided, f"B decided alone: {field.last('B').state}")
    finally:
        engines[0].tell(signal.SIGCONT)
    # Participants that took each other for dead may find each other only after half a minute.
    held(field.until(lambda: field.last("B").deployed == "d1", 60), "B did not start when it heard A again")


def bad_fields(field: Field) -> None:
    """Envelopes with a sequence from the far future, and invalid teams."""
    engine = field.start("A")
    field.say("/A/bpmn_process", envelope("A", "load", "d1", model=MISSION, sequence=FUTURE))
    field.pass_time(0.5)
    field.say("/A/bpmn_process", envelope("A", "abort", "d1", sequence=FUTURE))
    for number, team in enumerate((["A", "bad name!"], [5, None], [["A"]], ["x" * 100_000])):
        field.say("/A/bpmn_process", envelope("A", "load", f"t{number}", model=MISSION, team=team))
        field.pass_time(0.5)
    field.pass_time(7)
    held(engine.alive and field.speaks("A"), f"ended: {engine.said[-300:]}")
    field.say("/A/bpmn_process", envelope("A", "load", "d2", model=MISSION, team=["A"]))
    held(field.answer("A", "ready", 8), "takes no deployment any more")
    field.say("/A/bpmn_process", envelope("A", "abort", "d2"))
    field.pass_time(0.5)
    held(not (text := _deploys(field)), f"the next deployment failed: {text}")


def _forged(report: Report, **changes: object) -> str:
    return json.dumps(asdict(report) | changes)


def forged_birth(field: Field) -> None:
    """Under --trust: a stranger speaks as an older engine of the same name."""
    key, public = _keys(field)
    engine = field.start("A", "--trust", public)
    held(not (text := _deploys(field, "--key", key)), f"not deployed: {text}")
    for _ in range(10):
        field.say("/A/bpmn_status", _forged(field.last("A"), born=1))
        field.pass_time(0.2)
    held(engine.alive, f"a running mission was ended: {engine.said[-300:]}")
    held(engine.ends(5), "does not end on Ctrl-C")
    field.pass_time(1)
    field.engines.append(again := Engine("A", ("--trust", public), field.environment, field.folder, None))
    said = field.reports["A"][-1]
    for _ in range(25):
        field.say("/A/bpmn_status", _forged(said, born=1))
        field.pass_time(0.2)
    held(again.alive, f"a new engine was kept from starting: {again.said[-300:]}")


def forged_answers(field: Field) -> None:
    """Under --trust: a stranger says ready and started for a robot that is stopped."""
    key, public = _keys(field)
    field.start("A", "--trust", public)
    stopped = field.start("B", "--trust", public)
    said = field.last("B")
    stopped.tell(signal.SIGSTOP)

    def forge(message: object) -> None:
        """Answer as B whatever A answers."""
        report = Report.from_json(message.data)  # type: ignore[attr-defined]
        if report is not None and report.deployment:
            for answer in ("ready", "started"):
                text = _forged(said, answer=answer, deployment=report.deployment, deployed=report.deployment)
                field.say("/B/bpmn_status", text)

    field.publisher("/B/bpmn_status")
    field.stranger.subscription("/A/bpmn_status", STRING, forge, STATUS_QOS)
    result: list[str] = []
    person = threading.Thread(target=lambda: result.append(_deploys(field, "--key", key, "--wait", "8", text=TEAM)))
    person.start()
    field.until(lambda: not person.is_alive(), 50)
    person.join()
    stopped.tell(signal.SIGCONT)
    held(result[0], "half a team was deployed, and its sender believes in all")
    field.pass_time(0.5)
    held(field.last("A").state == "waiting" or field.last("A").state == "ready", f"A is {field.last('A').state}")


def strangers_key(field: Field) -> None:
    """Under --trust: a stranger deploys with a key of its own, forges, and repeats what was signed."""
    key, public = _keys(field)
    held(field.fame("keys", "new", str(field.folder / "stranger")).returncode == 0, "no keys")
    strange = field.folder / "stranger.key"
    private = read_private(strange)
    team = Team(field, "AB", "--trust", public, durable="A")

    def forge(robot: str, text: str) -> None:
        """Say the same with another signature, and with another phase under the same one."""
        real = read_envelope(text, robot, time.time())
        again = signed(real, private, born=real.born, now=time.time())
        others = [replace(one, phase=phase) for one in (again, real) for phase in ("start", "abort", "load")]
        others.append(signed(replace(real, phase="abort"), private, born=real.born, now=time.time()))
        for forged in (again, *(other for other in others if other != real)):
            field.say(f"/{robot}/bpmn_process", forged.to_json())

    team.finish("--key", key)
    team.on_sent = forge
    for _ in range(3):  # a stranger may keep a team from deploying, if its message is there first
        sender = team.deploy("--key", key)
        field.until(lambda sender=sender: not sender.alive, 60)
        team.judge()
    team.on_sent = lambda robot, text: None
    team.finish("--key", key)
    for words in ((), ("--key", str(strange))):
        sender = team.deploy(*words, "--wait", "4", stranger=True)
        field.until(lambda sender=sender: not sender.alive, 30)
        held(sender.process.poll() == 1, f"a stranger has deployed: {sender.outcome}")
    sender = team.deploy("--key", key, tasks=20_000)
    held(team.at("B ready", sender), "B was not ready")
    for robot in "AB":
        held(field.fame("abort", robot, "--key", str(strange)).returncode == 1, f"a stranger has aborted at {robot}")
    done = field.fame("complete", "A", "A_wait", "--key", str(strange))
    held(done.returncode == 1 and "not signed by a key" in f"{done}", f"a stranger has done a task: {done}")
    team.judge()
    held(sender.process.poll() == 0, f"a stranger has kept a team from deploying: {sender.outcome}")
    running = {robot.last.deployed for robot in team.robots.values()}
    for name in "AB":
        team.robots[name].process.kill()
        team.restart(name)
    team.await_robots()
    field.pass_time(3)
    team.said.clear()  # new engines refuse what is over
    for robot, text in list(team.sent):
        field.say(f"/{robot}/bpmn_process", text)
    field.pass_time(2)
    team.judge()
    now = {name: robot.last.deployed for name, robot in team.robots.items()}
    held(now == {"A": running.pop(), "B": ""}, f"what was recorded had an effect: {now}")
    team.finish("--key", key)
