"""What must hold of every run, whatever strikes: each function gives the sentences that do not hold."""

from __future__ import annotations

import json
import math
from base64 import b64decode
from bisect import bisect
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from fame.clock import SECOND
from fame.engine import Instance
from fame.engine.state import Mailbox
from fame.middleware.codec import deserialize
from fame.robot import RobotNode

from .drawn import LAST, RETRIES, closed, edits_of, help_needed, is_started, kinds_met, outcome_of, reference, steps_of
from .missions import WORK, version_of
from .once import computed_once
from .plan import DISK_FAULTS
from .processes import EndlessRunError, ids_of
from .states import differences
from .team import SEND_GOAL, STRANGER, Said, Team


def judge(team: Team) -> list[str]:
    """Run a team to its end, and return what does not hold."""
    with computed_once(), ids_of(team.plan.seed):
        try:
            return _judge(team)
        except EndlessRunError as error:
            return [str(error), *team.problems]


def _judge(team: Team) -> list[str]:
    team.run()
    if team.plan.mission is not None:
        return _concluded(team, _of_drawn(team))
    found = [
        *half_applied(team),
        *broken_promises(team),
        *undecided(team),
        *forgotten(team),
        *effects(team),
        *stuck(team),
        *strangers(team),
        *order(team),
        *alarms(team),
        *goals(team),
        *repairs(team),
        *works(team),
    ]
    for robot in team.robots.values():
        for _ in range(15):  # of 50 messages that wait, ten need it
            if team.repair(robot, ("retry", "move")[team.plan.seed % 2]):
                team.pass_time(1)
        if robot.engine is not None and robot.engine.state == "incident":
            found.append(f"{robot.name} is not mended although a person did what it takes")
    return _concluded(team, found)


def _of_drawn(team: Team) -> list[str]:
    """What does not hold of a drawn mission, whose end people help it to."""
    settled = finish(team)
    return [
        *half_applied(team),
        *broken_promises(team),
        *undecided(team),
        *forgotten(team),
        *strangers(team),
        *repairs(team),
        *started_alone(team),
        *(says(team) if settled else ()),
        *told(team),
        *heard(team),
        *acknowledged(team),
        *sent_again(team),
        *unlike_reference(team),
    ]


def _concluded(team: Team, found: list[str]) -> list[str]:
    """What holds no robot for ever: an abort, or the last deployment."""
    for robot in team.robots.values():
        for _ in range(5 * (team.plan.seed % 2)):  # in every other run: a newer deployment has to end it as well
            if robot.engine is not None and robot.engine.state == "holding":
                team.note(f"{robot.name} holds: a person aborts")
                team.abort(robot)
                for _ in range(10):
                    team.pass_time(1)
        if team.plan.seed % 2 and robot.engine is not None and robot.engine.state == "holding":
            found.append(f"{robot.name} holds although a person has aborted")
    sender = None
    if any(step.kind == "diagram" for step in team.plan.steps):
        team.publish_diagram(LAST)
    else:
        sender = team.deploy(LAST)
    for _ in range(40):
        if not (sender.ended if sender is not None else set(versions(team).values()) == {LAST}):
            team.pass_time(1)
    team.pass_time(1)
    if sender is not None and not sender.ended.startswith("started"):
        found.append(f"a new deployment has failed on a healthy team: {sender.ended or 'no end after 40 s'}")
    found += half_applied(team)
    others = [name for name, version in versions(team).items() if version != LAST]
    if not found and others:
        found.append(f"{', '.join(others)} does not run what was deployed on a healthy team")
    return list(dict.fromkeys([*found, *team.problems]))


def finish(team: Team) -> bool:
    """People do what the robots need, until all missions have ended or wait for something else: whether they do."""
    idle, still, visited = 0, 0, 0
    patience = 4 + 4 * max(robot.machine.slowest for robot in team.robots.values())  # what is sent is written before
    assert team.plan.mission is not None
    for _ in range(240 if team.plan.mission["calm"] else 120):  # the longest calm ones take 150 s without faults
        helped = waits = False
        for robot in team.robots.values():
            node = robot.engine.running if robot.engine is not None else None
            if node is None or (robot.engine is not None and robot.engine.state in ("holding", "ready")):
                continue
            needed = help_needed(node)
            if node.suspension.by:
                team.ask(robot, {"act": "continue"})
                helped = True
            elif needed:
                element, act, values = needed[0]
                team.ask(robot, {"act": act, "element": element, "values": values})
                helped = True
            elif node.engine.waits:  # a timer or script goes on
                waits = True
        team.pass_time(1)
        before, visited = visited, sum(sum(instance.visits.values()) for _, instance in _instances(team))
        still = still + 1 if visited == before else 0
        idle = 0 if helped else 1 if waits or not still else idle + 1
        if idle > patience or still > 45:  # it waits for a robot that holds: no timer, goal or disk takes so long
            return idle > patience
    return False


def told(team: Team) -> Iterator[str]:
    """Each robot tells numbers in order: none is left out, and only what left last before a crash is told again."""
    for robot in team.robots.values():
        if not robot.durable or robot.spoilt or robot.witness.changed:
            continue
        last: dict[int, tuple[int, str, list[int], float, int]] = {}
        starts = _starts(team, robot.name)
        for number, (time, process, message) in enumerate(team.fabric.published.get(team.tells(robot.name), ())):
            version, count = divmod(message.data, 1000)
            before, by, batch, at, run = last.get(version, (0, process, [], 0.0, 0))
            again = (process != by and count in batch) or (count == 1 and run != bisect(starts, number))
            if count != before + 1 and not again:
                yield f"{robot.name} has told {count} of version {version} after {before}"
            batch = [*batch, count] if time == at else [count]
            last[version] = count, process, batch, time, bisect(starts, number)


def _starts(team: Team, robot: str) -> list[int]:
    """At which of its effects a robot had started: what left before is that of the mission before, also just before."""
    return sorted(one.effects for one in team.said if (one.robot, one.answer) == (robot, "started"))


def heard(team: Team) -> Iterator[str]:
    """What a robot has heard of another is in order, without a gap, and none of it twice.

    A person who skips what hears, or moves a token behind it, keeps what was heard last once more; who moves one before
    what tells has it told again. So does a robot that has lost its state, and is given its mission once more.
    """
    for name, instance in _instances(team):
        if team.robots[name].witness.changed:
            continue
        for other, counts in dict(instance.variables.get("kept", {})).items():
            robot = team.robots[other]
            loses = (not robot.durable or robot.spoilt) and len(_starts(team, other)) > 1
            if robot.witness.changed or loses:
                continue
            for version in {count // 1000 for count in counts}:
                found = [count % 1000 for count in counts if count // 1000 == version]
                if found != list(range(found[0], found[0] + len(found))):
                    yield f"{name} has heard {found} of {other}, version {version}"


def acknowledged(team: Team) -> Iterator[str]:
    """What a robot has acknowledged, its mission has taken, or keeps in a queue.

    An instance that a signal starts gets nothing of before: its queues are opened with it.
    """
    assert team.plan.mission is not None
    for name, instance in _instances(team):
        robot = team.robots[name]
        if robot.spoilt or robot.witness.changed or not robot.durable or instance.status != "running":
            continue
        if sum((said.robot, said.answer) == (name, "started") for said in team.said) > 1:
            continue  # what was acknowledged before is that of another mission
        node = robot.engine.running if robot.engine is not None else None
        assert node is not None
        boxes = [one for all in node.engine.listeners.values() for one in all if isinstance(one, Mailbox)]
        kept = [message for box in boxes for _, message in box.messages]
        for other in set(team.robots) - {name}:
            signals = _of_json(team, f"/{name}/bpmn_signal/tell_{other}")
            answers = [one for one in _of_json(team, f"/{other}/bpmn_answer/tell_{other}") if one["robot"] == name]
            until = {one["sender"]: one["number"] for one in answers}
            types = [one for one in signals if one.get("number", 1 << 60) <= until.get(one["life"], 0)]
            told = {deserialize(b64decode(one["data"]), "std_msgs/msg/Int32").data for one in types}
            has = {*instance.variables.get("kept", {}).get(other, ()), *(getattr(one, "data", 0) for one in kept)}
            told = {one for one in told if one // 1000 == instance.variables.get("version")}
            first = min(told & has, default=math.inf) if is_started(team.plan.mission, name) else 0
            if lost := {one for one in told - has if one > first}:
                yield f"{name} has acknowledged {sorted(lost)} of {other}, and does not have them"


def _of_json(team: Team, topic: str) -> list[dict[str, Any]]:
    return [json.loads(message.data) for _, _, message in team.fabric.published.get(topic, ())]


def sent_again(team: Team) -> Iterator[str]:
    """A goal is sent once; again where its `retry` allows that after a crash, or it was cancelled or made again."""
    last: dict[tuple[str, int, int], float] = {}
    for time, process, message in team.fabric.published.get(SEND_GOAL, ()):
        robot, place = team.robots[process.partition("#")[0]], message.goal.pose.pose.position
        run = sum((one.robot, one.answer) == (robot.name, "started") and one.time <= time for one in team.said)
        key = robot.name, run, round(place.x)
        allowed = {"cancel"} if RETRIES[round(place.z)] == "never" else {"cancel", "crash", "server"}
        excused = any(last.get(key, 0) <= at <= time and why in allowed for at, why in robot.excuses)
        started = team.plan.mission is not None and is_started(team.plan.mission, robot.name)
        excused |= robot.witness.changed and last.get(key) == time  # by two tokens, after a move
        if key in last and not (excused or started):
            yield f"{robot.name} has sent its goal {place.x:g} again, retry {RETRIES[round(place.z)]}"
        last[key] = time


def started_alone(team: Team) -> Iterator[str]:
    """What one robot has started, all others start, or something newer; or they say that they hold.

    A splitter gives what runs to one that has come back, alone. One that lost its power before it could answer has
    started what it runs.
    """
    started = dict.fromkeys(said.deployment for said in team.said if said.answer == "started")
    for deployment in [one for one in started if one.startswith("sender")]:
        first = min(said.time for said in team.said if (said.deployment, said.answer) == (deployment, "started"))
        for name, robot in team.robots.items():
            newer = any(one.robot == name and one.answer == "started" and one.time >= first for one in team.said)
            holds = robot.engine is None or robot.engine.state in ("holding", "suspended", "loading", "ready")
            free = not robot.durable or robot.spoilt or (name, deployment) in team.released
            free = free or (robot.engine is not None and robot.engine.deployed == deployment)
            if not (newer or holds or free):
                yield f"{name} has not started {deployment}, which others have"


def says(team: Team) -> Iterator[str]:
    """What a robot says in its status is so."""
    for robot in team.robots.values():
        node = robot.engine.running if robot.engine is not None else None
        reports = team.fabric.published.get(f"/{robot.name}/bpmn_status", [])
        if node is None or robot.engine is None or robot.process is None or not reports:
            continue
        said = json.loads(reports[-1][2].data)
        is_so = {
            "deployed": robot.engine.deployed,
            "incidents": sorted(one.node.id for one in node.engine.incidents),
            "suspended": node.suspension.by,
        }
        incidents = sorted(one["element"] for one in said.get("incidents") or ())
        says = {
            "deployed": said["deployed"],
            "incidents": incidents,
            "suspended": (said["suspended"] or {}).get("by", ""),
        }
        if reports[-1][1] == robot.process.name and says != is_so:
            yield f"{robot.name} says {says}, but it is {is_so}"


def _instances(team: Team) -> Iterator[tuple[str, Instance]]:
    for robot in team.robots.values():
        node = robot.engine.running if robot.engine is not None else None
        for instance in node.instances if node is not None else ():
            yield robot.name, instance


def unlike_reference(team: Team) -> Iterator[str]:
    """Each robot of a calm mission has become what it becomes where nothing fails."""
    mission = team.plan.mission
    assert mission is not None
    team.struck["missions drawn"] += 1
    team.struck["missions drawn that are calm"] += mission["calm"]
    running, robots = versions(team), team.robots
    begun = {name: {one.variables.get("version") for who, one in _instances(team) if who == name} for name in robots}
    team.struck.update(f"element {kind}" for kind in kinds_met(mission, team.entered))
    migrated = {version for version in running.values() if version is not None} - set[Any]().union(*begun.values())
    team.struck.update(f"edit {edit[0]}" for version in migrated for edit in edits_of(mission, version).values())
    crashes = ([why for _, why in robot.excuses].count("crash") for robot in robots.values())
    team.struck["crashes in a row"] += sum(number > 2 for number in crashes)
    kept = {name: next(iter(found)) for name, found in begun.items() if len(found) == 1 and _keeps(team, name, *found)}
    compared = closed(mission, kept)
    counts = {"drawn": len(robots), "compared with a reference": len(compared)}
    counts["compared after a restart"] = sum(_has_restarted(team, name) for name in compared)
    team.struck.update({f"robots {how}": count for how, count in counts.items()})
    team.struck["missions compared with a reference"] += bool(compared)
    team.struck["missions compared as a whole"] += compared.keys() == robots.keys()
    references = {version: reference(team.text(version)) for version in sorted({*compared.values()})}
    yield from (text for _, wrong in references.values() for text in wrong)
    for name, version in compared.items():
        node = robots[name].engine.running
        for text in differences(references[version][0][name], outcome_of(node)):
            yield f"{name} is not what it is without faults: {text}"


def _has_restarted(team: Team, name: str) -> bool:
    """Whether a robot has crashed since its mission was started."""
    started = max((said.time for said in team.said if (said.robot, said.answer) == (name, "started")), default=math.inf)
    return any(why == "crash" and time > started for time, why in team.robots[name].excuses)


def _keeps(team: Team, name: str, first: int | None) -> bool:
    """Whether a robot has kept its calm mission, of the version `first`; a migration that edits others changes none."""
    mission, robot = team.plan.mission, team.robots[name]
    assert mission is not None
    node = robot.engine.running if robot.engine is not None and robot.engine.state != "holding" else None
    kept = mission["calm"] and robot.durable and not (robot.spoilt or robot.witness.changed) and first is not None
    if not kept or node is None or robot.process is None:
        return False
    waiting = [element for one in node.instances for element in one.waiting]
    if robot.process.name in team.fabric.unheard and any("_go_" in one or "_ask_" in one for one in waiting):
        return False  # for an answer: nothing tells it that its server has not got the request
    dated = any("_date_" in element for element in waiting)  # a clock far behind
    several = len({said.deployment for said in team.said if said.answer == "started"}) > 1 and _hears_anybody(
        team, node
    )
    return not dated and not several and steps_of(mission, name, first) == steps_of(mission, name, versions(team)[name])


def _hears_anybody(team: Team, node: RobotNode) -> bool:
    """Whether a robot catches what robots have thrown, perhaps for the mission before: plain topics promise nothing.

    What it throws itself is of its version: that may be of the mission before if the same version has begun again.
    """
    migrations = {sender.process.name for sender in team.senders if sender.migrates}
    starts = [one for one in team.said if (one.robot, one.answer) == (node.name, "started")]
    begun = max((one.time for one in starts if one.deployment not in migrations), default=0.0)
    for use in node.mission.types.values():
        thrown = [time for time, *_ in team.fabric.published.get(use.name, ())] if use.catches and not use.ttl else []
        if thrown and not (use.throws and thrown[0] > begun):
            return True
    return False


def half_applied(team: Team) -> Iterator[str]:
    """Never one robot on the new model and another on the old one."""
    return mixed({name: (version, state(team, name)) for name, version in versions(team).items()})


def mixed(engines: Mapping[str, tuple[int | str | None, str]]) -> Iterator[str]:
    """The same of engines of which version and state are given, as of real ones."""
    running = {
        name: version
        for name, (version, state) in engines.items()
        if version is not None and state not in ("holding", "suspended")
    }
    if len(set(running.values())) > 1:
        where = ", ".join(f"{name} runs {version}" for name, version in running.items())
        yield f"half applied: {where}"


def state(team: Team, name: str) -> str:
    """What an engine reports."""
    engine = team.robots[name].engine
    return engine.state if engine is not None else ""


def versions(team: Team) -> dict[str, int | None]:
    """The version that each robot runs."""
    running = {robot.name: robot.engine.running for robot in team.robots.values() if robot.engine is not None}
    return {
        name: None if process is None else version_of(process.mission.definitions) for name, process in running.items()
    }


def broken_promises(team: Team) -> Iterator[str]:
    """An engine that said ready keeps its promise, or nobody starts; one without a directory dies with its promise."""

    def engine(said: Said) -> str:
        robot = team.robots[said.robot]
        return said.robot if robot.durable and not robot.spoilt else said.process

    ready: set[tuple[str, str]] = set()
    started = {said.deployment for said in team.said if said.answer == "started"}
    for said in team.said:
        key = engine(said), said.deployment
        ready |= {key} if said.answer == "ready" else set()
        broken = said.answer in ("aborted", "refused") and key in ready and said.deployment in started
        if broken and (said.robot, said.deployment) not in team.released:
            yield f"{said.robot} said ready, then {said.answer} to {said.deployment}, which others have started"


def undecided(team: Team) -> Iterator[str]:
    """Every deployment ends once the network is whole."""
    for sender in team.senders:
        if sender.alive:
            yield f"{sender.process.name} has not ended {60} s after the last fault"


def forgotten(team: Team) -> Iterator[str]:
    """A robot with a directory runs what it ran, or something newer, or holds for it."""
    for robot in team.robots.values():
        began = [said.deployment for said in team.said if (said.robot, said.answer) == (robot.name, "started")]
        engine = robot.engine
        knows = engine is not None and (engine.deployed or engine.state == "holding")
        if robot.durable and not robot.spoilt and began and not knows:
            yield f"{robot.name} has forgotten {began[-1]}"


def effects(team: Team) -> Iterator[str]:
    """No effect is lost, and none is repeated but by another process after a crash. A new start begins anew.

    Without a directory, or with a disk that rots, A may only begin anew or further back: it never makes up a count.
    """
    keeps = team.robots["A"].durable and not team.robots["A"].spoilt
    starts = _starts(team, "A")
    last: dict[int, tuple[int, str, int]] = {}
    for number, (_, process, message) in enumerate(team.fabric.published.get(team.tells("A"), ())):
        version, count = divmod(message.data, 1000)
        before, by, run = last.get(version, (0, process, 0))
        if count == 1 and run != bisect(starts, number):
            before = 0
        if count > before + 1:
            yield f"A has lost effects: after {before} of version {version} comes {count}"
        elif count <= before and process == by:
            if keeps or count > 1:
                yield f"A has repeated {count} of version {version} without a crash"
        elif count < before and keeps:
            yield f"A has forgotten effects: after {before} of version {version} comes {count}"
        further_back = process != by and not keeps  # and from there on: what rotted may be more than one effect
        last[version] = count if further_back else max(before, count), process, bisect(starts, number)


_LOSING = {"cut", "mute", "match", "stop", "kill", "memory", "migrate", "repair", *DISK_FAULTS}
"""What separates robots, ends one for a while, or lets a person move the token with what it was about to keep."""


def order(team: Team) -> Iterator[str]:
    """What a robot has taken is in its sender's order, nothing more often than it was sent; and nothing is left out."""
    sent = Counter(message.data for _, _, message in team.fabric.published.get("/tick", ()))
    for robot in list(team.robots.values())[1:]:
        process = robot.engine.running if robot.engine is not None else None
        for instance in process.engine.instances.values() if process is not None else ():
            taken = list(instance.variables.get("kept", ()))
            if too_often := Counter(taken) - sent:
                yield f"{robot.name} has taken {sorted(too_often)} more often than they were sent"
            for version in {count // 1000 for count in taken if max(sent.values()) == 1}:
                counts = [count for count in taken if count // 1000 == version]
                if counts != sorted(counts):
                    yield f"{robot.name} has taken counts out of order: {counts}"
                elif "acknowledges" in team.more:
                    yield from _unreported(team, robot.name, counts)
                elif len(counts) <= counts[-1] - counts[0] and not _LOSING & {step.kind for step in team.plan.steps}:
                    yield f"{robot.name} has lost counts without a cause: {counts}"


def alarms(team: Team) -> Iterator[str]:
    """Every second count raises one alarm of a monitor; B catches each once, and since the last fault all in order."""
    ticks = [(time, message.data) for time, _, message in team.fabric.published.get("/tick", ())]
    said = Counter(count for _, count in ticks)
    raised = Counter((process, round(message.data)) for _, process, message in team.fabric.published.get("/alarm", ()))
    for (monitor, count), number in raised.items():
        if not count % 2 or number > said[count]:
            yield f"{monitor} has raised {number} alarms for {count}, which was said {said[count]} times"
    robot = team.robots["B"]
    process = robot.engine.running if robot.engine is not None else None
    for instance in process.engine.instances.values() if process is not None else ():
        taken = list(instance.variables.get("alarms", ()))
        if too_often := Counter(taken) - Counter(count for _, count in raised.elements()):
            yield f"B has caught alarms {sorted(too_often)} more often than they were raised"
        if max(said.values(), default=0) == 1 and not {"migrate", "repair"} & {step.kind for step in team.plan.steps}:
            since, now = max(team.healed + 1, robot.began), taken[-1] // 1000 if taken else 0
            late = [count for time, count in ticks if time > since and count % 2 and count // 1000 == now]
            caught = [count for count in taken if count in late]
            if caught and caught != late[late.index(caught[0]) : late.index(caught[-1]) + 1]:
                yield f"B has caught {caught} of the alarms {late} since the last fault"


_OF_THE_DISK = {"repair", *DISK_FAULTS} - {"power"}


def _unreported(team: Team, robot: str, counts: list[int]) -> Iterator[str]:
    """Acknowledged counts that one robot has not taken although it ran, and nobody has reported."""
    kinds = {step.kind for step in team.plan.steps}
    dying = {"kill", "power"} & kinds and not team.robots["A"].durable
    missing = counts[-1] - counts[0] + 1 - len(counts)
    if missing > team.expired[robot] and not (dying or _OF_THE_DISK & kinds):
        yield f"{robot} has lost {missing} acknowledged counts, {team.expired[robot]} were reported: {counts}"


def repairs(team: Team) -> Iterator[str]:
    """What a person asks for is done once, however often it is asked: a robot gives one answer to each request.

    Nor is it done if the person is told that it is refused. A robot without a directory forgets with its process; one
    that says that its state cannot be written, what it has answered since. One without memory refuses what it cannot
    look up, also if it was done before: that is open. One whose clock is wrong refuses a signature, not the request.
    """
    answers: dict[tuple[str, str], set[str]] = {}
    for said in team.said:
        asked_again = said.reason.startswith(("no memory is left", "signed "))
        if said.deployment.startswith("person") and not asked_again:
            robot = team.robots[said.robot]
            keeps = robot.durable and not robot.spoilt and "it is lost in a crash" not in said.reason
            answers.setdefault((said.robot if keeps else said.process, said.deployment), set()).add(said.answer)
    for (who, request), found in answers.items():
        if len(found) > 1:
            yield f"{who} has answered {', '.join(sorted(found))} to {request}"
        if found != {"refused"} and team.told.get(request) == "refused" and who in team.robots:
            yield f"{who} has answered {', '.join(sorted(found))} to {request}, of which its person knows a refusal"


def works(team: Team) -> Iterator[str]:
    """What is in progress is done once at a time: where a copy of it has begun, no other one of the process goes on."""
    copies: dict[str, list[int]] = {}
    for _, process, message in team.fabric.published.get(WORK, ()):
        begun = copies.setdefault(process, [message.data])
        if message.data in begun[:-1]:
            yield f"{process} does its work in two copies"
        elif message.data != begun[-1]:
            begun.append(message.data)


_SUSPENDING = {
    "cut", "mute", "match", "stop", "loss", "migrate", "full", "read-only", "kill", "suspend",
    "kill sender", "stop sender", "kill splitter", "stop splitter",
}  # fmt: skip
"""What makes robots hold, or lose the server: a goal is cancelled then, and sent again."""


def goals(team: Team) -> Iterator[str]:
    """No goal is sent twice, unless A was killed or held meanwhile, or the server was away."""
    crashes = sum(process.startswith("A#") for process, _ in {(said.process, 0) for said in team.said}) > 1
    if crashes or team.unserved or "A" in team.held or any(step.kind in _SUSPENDING for step in team.plan.steps):
        return
    for count, number in Counter(count for _, count in team.goals).items():
        if number > 1:
            yield f"A has sent its goal {count} {number} times"


_SILENCE = 5.0
"""How long a mission may do nothing (s): each second, at most, A has something to say."""


def stuck(team: Team) -> Iterator[str]:
    """A mission that runs goes on: A says counts, the others take them, and B catches the alarms of the monitor."""
    states = {name: robot.engine.state for name, robot in team.robots.items() if robot.engine is not None}
    for name, state in states.items():
        if state == "idle":
            yield f"{name} has lost its mission, which has no end"
    since = team.scheduler.now / SECOND - _SILENCE
    begun = {said.robot for said in team.said if said.answer == "started" and said.time > since}
    runs, said = {name for name, state in states.items() if state == "running"} - begun, _lately(team, "/tick")
    if "A" in runs and not said:
        yield f"A runs and does nothing for {_SILENCE:g} s"
    for name in ("B", "C"):
        if _lately(team, "/tick", before=1.0) and name in runs and _last(team, name, "kept") not in said:
            yield f"{name} runs and takes nothing for {_SILENCE:g} s: {said}"
    alarms = _lately(team, "/alarm")
    if _lately(team, "/alarm", before=1.0) and "B" in runs and _last(team, "B", "alarms") not in alarms:
        yield f"B runs and catches no alarm for {_SILENCE:g} s: {alarms}"


def _lately(team: Team, topic: str, *, before: float = 0.0) -> list[int]:
    """What was published on a topic lately; `before` those last seconds (s) in which it may be on its way."""
    now, published = team.scheduler.now / SECOND, team.fabric.published.get(topic, ())
    return [round(message.data) for time, _, message in published if now - _SILENCE <= time <= now - before]


def _last(team: Team, robot: str, variable: str) -> int | None:
    """The last value in a list of a robot's mission."""
    engine = team.robots[robot].engine
    process = engine.running if engine is not None else None
    for instance in process.engine.instances.values() if process is not None else ():
        if values := instance.variables.get(variable):
            return int(values[-1])
    return None


def strangers(team: Team) -> Iterator[str]:
    """What no key of the team has signed changes none of its robots."""
    unsigned = {sender.process.name for sender in team.senders if sender.version == STRANGER}
    for said in team.said:
        if said.deployment in unsigned and said.answer in ("ready", "started"):
            yield f"{said.robot} said {said.answer} to a stranger's {said.deployment}"
