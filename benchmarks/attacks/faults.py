"""Attacks on deployments by what befalls processes: each is stopped or killed in each phase."""

from __future__ import annotations

import random
import signal

from attacks.field import Field, held
from attacks.team import Team

MOMENTS = ("", "load", "B ready", "A ready", "start", "B started", "A started")
"""Of a deployment at which somebody is stopped: soon after the sender begins, or when something is said."""
TASKS = 4000
"""So many keep A loading while B is ready."""
SHORT, LONG = 2.0, 7.0
"""Shorter, and longer, than the lease of DDS and the time that a robot waits for its sender (s)."""


def _stopped(field: Field, victim: str) -> None:
    team = Team(field, "AB")
    for number, moment in enumerate(MOMENTS):
        sender = team.deploy(tasks=TASKS)
        if moment:
            held(team.at(moment, sender), f"no {moment!r}: {sender.outcome if not sender.alive else 'silence'}")
        else:
            field.pass_time(0.6)
        process = sender.process if victim == "sender" else team.robots[victim].process.process
        process.send_signal(signal.SIGSTOP)
        field.pass_time((SHORT, LONG)[number % 2])
        process.send_signal(signal.SIGCONT)
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
    for number, moment in enumerate(("load", "R1 ready", "R2 started", "R1 ready")):
        sender = team.deploy(tasks=TASKS)
        held(team.at(moment, sender), f"no {moment!r}: {sender.outcome if not sender.alive else 'silence'}")
        victims = random.Random(number).sample(names, len(names) // 2)
        for name in victims:
            team.robots[name].process.process.kill()
        if number == 3:
            sender.process.kill()
        field.pass_time(3)
        for name in victims:
            team.restart(name)
        team.await_robots()
        team.judge()
    team.finish()
