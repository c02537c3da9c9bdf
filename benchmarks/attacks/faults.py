"""Attacks on deployments by what befalls processes: each is stopped or killed in each phase."""

from __future__ import annotations

import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from attacks import relay as bad_relay
from attacks.field import Field, NotRun, held
from attacks.team import Sender, Team, mission
from fame.bpmn.reader import read_text
from fame.deploy import STRING, Deployment
from fame.deploy.leader_election import GONE
from fame.deploy.options import DeploymentOptions

MOMENTS = ("", "load", "B ready", "A ready", "start", "A started")
"""Of a deployment at which somebody is stopped: soon after the sender begins, or when something is said."""
TASKS = 4000
"""So many keep A loading while B is ready."""
SHORT, LONG = 2.0, 7.0
"""Shorter, and longer, than the lease of DDS and the time that a robot waits for its sender (s)."""

BURSTS, PEOPLE = 8, 4
REDEPLOYMENTS, GROWTH = 500, 5
"""How many, and how much the last 400 may add to what an engine holds (MB)."""


def _stopped(field: Field, victim: str) -> None:
    team = Team(field, "AB")
    for number, moment in enumerate(MOMENTS):
        sender = team.deploy("--wait", "60", tasks=TASKS)  # a busy machine makes a robot silent for longer than 10 s
        if moment:
            held(team.at(moment, sender), f"no {moment!r}: {sender.outcome if not sender.alive else 'silence'}")
        else:
            field.pass_time(0.6)
        tell = sender.process.send_signal if victim == "sender" else team.robots[victim].process.tell
        tell(signal.SIGSTOP)
        field.pass_time((SHORT, LONG)[number % 2])
        tell(signal.SIGCONT)
        team.judge()
    team.finish()


def stopped_sender(field: Field) -> None:
    """The sender of a deployment is stopped and continued, in each phase."""
    _stopped(field, "sender")


def stopped_first(field: Field) -> None:
    """The robot that is ready first is stopped and continued, in each phase of a deployment."""
    _stopped(field, "B")


def stopped_last(field: Field) -> None:
    """The robot that is ready last is stopped and continued, in each phase of a deployment."""
    _stopped(field, "A")


def half_killed(field: Field) -> None:
    """Half of 20 engines are killed while deploying, at last with the sender, and started again."""
    names = [f"R{number}" for number in range(20)]
    team = Team(field, names, durable=names[::2])
    team.finish()
    for number, moment in enumerate(("load", "R2 started", "R1 ready")):
        sender = team.deploy(tasks=TASKS)
        held(team.at(moment, sender), f"no {moment!r}: {sender.outcome if not sender.alive else 'silence'}")
        victims = random.Random(number).sample(names, len(names) // 2)
        for name in victims:
            team.robots[name].process.kill()
        if number == 2:
            sender.process.kill()
        field.pass_time(3)
        for name in victims:
            team.restart(name)
        team.await_robots()
        team.judge()
    team.finish()


def redeployments(field: Field) -> None:
    """500 redeployments of two robots: the last 400 take no memory, threads or files."""
    team = Team(field, "AB", durable="A")
    texts = [mission(version, "AB", tasks=100) for version in (1, 2)]
    before = {}
    for number in range(1, REDEPLOYMENTS + 1):
        _redeploy(field, texts[number % 2], number)
        if number == REDEPLOYMENTS // 5:
            before = {name: robot.process.holds() for name, robot in team.robots.items()}
    for name, robot in team.robots.items():
        (megabytes, *others), (megabytes_before, *others_before) = robot.process.holds(), before[name]
        held(megabytes - megabytes_before < GROWTH, f"{name} grew from {megabytes_before} to {megabytes} MB")
        more = any(after > then for after, then in zip(others, others_before, strict=True))
        held(not more, f"{name} has {others} threads and files, had {others_before}")
    team.judge()


def _redeploy(field: Field, text: str, number: int) -> None:
    """Deploy a model to A and B, in this process unless there is time for a command each."""
    if field.long:
        done = field.fame("deploy", field.file("again.bpmn", text))
        held(done.returncode == 0, f"redeployment {number} failed: {done.stdout}{done.stderr}")
        return
    deployment = Deployment(
        read_text(text, file="again.bpmn"),
        id=f"redeployment {number}",
        sequence=round(time.time() * 1e6),
        scheduler=field.scheduler,
        middleware=field.middleware,
        ended=lambda _: None,
        options=DeploymentOptions(robots=["A", "B"]),
    )
    deployment.begin()
    held(field.until(lambda: deployment.done, 30), f"redeployment {number} does not end")
    held(not deployment.failed, f"redeployment {number} failed: {deployment.robots}")
    deployment.close()


def flapping(field: Field) -> None:
    """Four people deploy at the same moment, eight times: one succeeds, and all robots end on the same, the newest."""
    team = Team(field, "ABC", durable="B")
    for _ in range(BURSTS):
        for _ in range(PEOPLE):
            team.deploy(tasks=TASKS)
        field.until(lambda: not any(sender.alive for sender in team.senders), 60)
        burst = team.senders[-PEOPLE:]
        done = any(sender.process.poll() == 0 for sender in burst)
        held(done, f"none of {PEOPLE} has deployed: {[sender.outcome for sender in burst if not sender.alive]}")
    team.judge()
    running = {robot.last.deployed for robot in team.robots.values() if robot.last is not None}
    newest = max((said.deployment for said in team.said if said.answer == "started"), key=team.sequences.get)
    held(running == {newest}, f"{running} run, the newest that started is {newest}")
    team.finish()


def late_joiners(field: Field) -> None:
    """Robots join, and one starts again, in each phase of a splitter's deployment: all end on the newest."""
    team = Team(field, ("A", "R_1"), fleet="R")
    splitter = field.begin("splitter", "--wait", "60")
    numbers = itertools.count(2)
    for _ in range(3):
        version, file = team.write(tasks=TASKS)
        sender = Sender(version, splitter)
        field.say("/collaboration_diagram", Path(file).read_text())
        for moment in ("load", "R_1 ready", "A started"):
            held(team.at(moment, sender), f"no {moment!r}")
            team.start(f"R_{next(numbers)}")
            if moment == "load" and version == 2:
                team.robots["R_1"].process.kill()
                team.restart("R_1")
        team.await_version(version)
        team.judge()
    team.finish()  # by a person: the splitter has the version before
    team.start(last := f"R_{next(numbers)}")
    team.await_robots()
    field.pass_time(SHORT)
    team.judge()
    held(team.robots[last].last.state == "waiting", f"{last} is {team.robots[last].last.state}")


def two_splitters(field: Field) -> None:
    """Of two splitters the leader is killed, or stopped and continued, while it deploys: the newest runs everywhere."""
    team, roles = Team(field, "AB", durable="A"), dict[int, tuple[float, str]]()

    def note(message: Any) -> None:
        role = json.loads(message.data)
        roles[role["born"]] = time.monotonic(), role["state"]

    def one_leads() -> bool:
        there = [state for at, state in roles.values() if time.monotonic() - at < GONE]
        return len(there) == len(splitters) == 1 + there.count("standby")

    field.stranger.subscription("/fame_splitter", STRING, note)
    splitters = [field.begin("splitter")]
    strikes = {"load": signal.SIGKILL, "A started": signal.SIGKILL, "B ready": signal.SIGSTOP, "": None}
    for moment, strike in strikes.items():
        held(field.until(one_leads, 40), f"splitters do not agree: {roles}")
        if len(splitters) == 1:
            splitters.append(field.begin("splitter"))
            held(field.until(one_leads, 40), f"splitters do not agree: {roles}")
        field.pass_time(1)  # so that both hear who sends diagrams
        for _ in range(1 if strike else 3):
            version, file = team.write(tasks=TASKS // 4)
            field.say("/collaboration_diagram", Path(file).read_text())
        leader = splitters[0]
        if strike:
            held(team.at(moment, Sender(version, leader)), f"no {moment!r}")
            leader.send_signal(strike)
            field.pass_time(LONG)
            leader.send_signal(signal.SIGCONT)
        team.await_version(version)
        splitters = [splitter for splitter in splitters if splitter.poll() is None]
        team.judge()
        before = [robot.last.deployed for robot in team.robots.values()]
        field.pass_time(LONG)
        held(before == [robot.last.deployed for robot in team.robots.values()], "what ran was started again")


def fifty_over_zenoh(field: Field) -> None:
    """Ten of 50 engines over Zenoh are killed while deploying, ten others stopped: those that are there agree."""
    if find_spec("zenoh") is None:
        raise NotRun("zenoh is not installed")
    field.change_middleware("zenoh")
    names = [f"R{number}" for number in range(50)]
    team = Team(field, names, together=True)
    team.finish("--wait", "120")
    sender = team.deploy("--wait", "60", tasks=TASKS)
    held(team.at("R1 ready", sender), f"R1 is not ready: {sender.outcome if not sender.alive else 'silence'}")
    for name in names[10:20]:
        team.robots[name].process.tell(signal.SIGSTOP)
    for name in names[20:30]:
        team.robots[name].process.kill()
    field.pass_time(LONG)
    team.judge()
    for name in names[20:30]:
        team.restart(name)
    team.await_robots()
    team.finish("--wait", "120")


def bad_network(field: Field) -> None:
    """Two machines whose UDP packets are lost, doubled, delayed and overtaken, or that are cut off in each phase."""
    if os.geteuid() or subprocess.run(["unshare", "-n", "true"], check=False, stderr=subprocess.DEVNULL).returncode:
        raise NotRun("no network namespaces: needs root")
    relay = field.open(["unshare", "-n", sys.executable, bad_relay.__file__])
    said = relay.stdout.readline().split()
    if len(said) != 2:
        raise NotRun(f"no veth between network namespaces: {relay.communicate()[1][-300:]}")

    def network(loss: float, duplicates: float = 0.0, delay: float = 0.0) -> None:
        relay.stdin.write(f"{loss} {duplicates} {delay}\n")
        relay.stdin.flush()

    here, there = said
    field.enter(int(here), bad_relay.INTERFACE)
    field.elsewhere = {"B": ("nsenter", "-t", there, "-n")}
    team = Team(field, "AB", "--insecure", durable="A")
    team.finish()
    for loss, duplicates, delay in ((0.1, 0.1, 0.05), (0.3, 0.3, 0.2), (0.0, 0.5, 1.0)):
        network(loss, duplicates, delay)
        sender = team.deploy()
        field.until(lambda sender=sender: not sender.alive, 60)
        network(0)
        team.judge()
    for moment in MOMENTS[1:5]:
        sender = team.deploy(tasks=TASKS)
        held(team.at(moment, sender), f"no {moment!r}: {sender.outcome if not sender.alive else 'silence'}")
        network(1)
        field.pass_time(LONG)
        network(0)
        team.judge()
    team.finish()
