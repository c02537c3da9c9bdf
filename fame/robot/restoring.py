"""A robot's state between its node and the disk: tables, timers, what elements say about resumption, files of a state.

`restored` gives a node the engine of a journal, `go_on` lets it move. `save` and `load` do so with one file, without a
journal.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.engine.program import Program
from fame.engine.state import Wait
from fame.errors import ConfigError, MissionError
from fame.robot.journal import SegmentContents, write_segment
from fame.robot.node import INCIDENT, RobotNode
from fame.robot.state_tables import (
    StateTables,
    Tables,
    fold,
    instance_data,
    instance_of,
    restore_engine,
    slots_of,
)
from fame.robot.stored_values import StoredValues
from fame.robot.suspension import SUSPENDED

if TYPE_CHECKING:
    from fame.robot.options import RobotOptions

_UNIX = datetime(1970, 1, 1, tzinfo=UTC)


def epoch_of(node: RobotNode | RobotOptions) -> int:
    """Return the date of second 0 of the mission's time (ns since 1970)."""
    return (node.epoch - _UNIX) // timedelta(microseconds=1) * 1000


def tables_of(node: RobotNode, epoch: int) -> Tables:
    """Return the tables of a robot's state beside its engine. `epoch` is as of `epoch_of`."""
    host = node.host
    timers = host.timers.state().items()
    signals = node.acknowledged.tables(epoch) if node.acknowledged is not None else {}
    return {
        **signals,
        "suspension": node.suspension.table(epoch),
        "people": node.waiting.table(node.engine, epoch),
        "timers": {str(key): [kind, text, base + epoch, fired] for key, (kind, text, base, fired) in timers},
        "totals": {"": [host.started, host.completed, host.failed, host.elements_done]},
        "cancelled": host.runner.cancelled.table(),
        "unanswered": {
            str(wait.key): [made, goal.hex()]
            for wait, (made, goal) in host.unanswered.items()
            if wait.alive and not (goal and host.runner.cancelled.outcome(goal) == "canceled")
        },
    }


def set_timers(node: RobotNode, tables: Tables, set_back: int = 0) -> list[Wait]:
    """Set the timers of a restored engine. Returns the waits whose timer was missed and is to fail.

    Where the clock was `set_back` (ns), durations and cycles keep what was left of them; dates are those of the clock.
    """
    failed, engine, policies = [], node.engine, node.mission.missed()
    for text, (kind, expression, base, fired) in tables.get("timers", {}).items():
        key = int(text)
        if key not in engine.waits and key not in engine.armed_starts:
            continue
        element = engine.timed(key).id
        missed = policies.get(element, "fire")
        base -= epoch_of(node) + (set_back if kind != "date" else 0)
        late = node.host.timers.resume(key, kind, expression, base, fired, missed)
        if late:
            node.host.report(element, f"{kind} timer {expression} came due while the engine was away: {missed}")
        if late and missed == "fail" and key in engine.waits:
            failed.append(engine.waits[key])
    return failed


def goals_under_way(tables: Tables) -> dict[str, tuple[str, str, bool]]:
    """Return the goals that may still run, those that were cancelled too, as `CancelledGoals.take_up` takes them."""
    cancelled = {id: (action, type, told) for id, (action, type, told) in tables.get("cancelled", {}).items()}
    return {**cancelled, **{id: (action, type, False) for id, action, type in tables.get("goals", {}).values()}}


def follow_cancelled(node: RobotNode, tables: Tables) -> None:
    """Cancel the goals once more that were cancelled before and had not ended, and report them anew."""
    goals = {id: (action, type, False) for id, (action, type, _) in tables.get("cancelled", {}).items()}
    node.runner.cancelled.take_up(goals, node.runner.inbox.action)


def take_unanswered(node: RobotNode, tables: Tables) -> None:
    """Let a restored engine know of the calls and goals that had not ended before their tasks were suspended."""
    waits, known = node.engine.waits, tables.get("unanswered", {}).items()
    node.host.unanswered = {
        waits[int(key)]: (made, bytes.fromhex(goal)) for key, (made, goal) in known if int(key) in waits
    }


def go_on(node: RobotNode) -> None:
    """Continue with a restored engine: scripts start again, and messages are delivered."""
    for reason, holds in ((INCIDENT, node.engine.incidents), (SUSPENDED, node.suspension.by)):
        if holds:
            node.hold(reason)
    if not node.holds:
        node.engine.release()
    node.engine.restart()
    node.go_on()


def description(program: Program) -> dict[str, Any]:
    """Return what the file of a state says of its program: the hash of its texts, and the elements that it counts."""
    return {"program": program.hash, "elements": program.elements}


# ---- journals --------------------------------------------------------------------------------------------------------


def restored(node: RobotNode, contents: SegmentContents) -> Tables:
    """Restore the engine of a robot's node from a journal; nothing moves until `DurableRecorder.go_on`, or `go_on`.

    A state belongs to the texts of its model. Where another FAME has made something else of them, it goes over by the
    ids of elements, as in a migration. Raises ConfigError for the journal of another model or robot, and for what has
    no place any more.
    """
    tables: Tables = {}
    for change in contents.records():
        fold(tables, change)
    load = StoredValues(node.mission, lambda reason: node.host.report("", reason)).load
    program, moved = node.engine.program, dict[str, str]()
    elements = contents.header.get("elements", program.elements)
    if "elements" not in contents.header:  # FAME 0.2 named what it had made of the model; an envelope has the text
        if "simulation" in contents.header and tables["engine"]["program"] != program.made:
            node.host.report("", "it is not known whether the state was saved with this text of the model")
        tables["engine"]["program"] = program.hash
    try:
        engine = restore_engine(
            tables, program, node.host, node.engine.new_variables, load, elements=elements, moved=moved
        )
    except MissionError as error:
        raise ConfigError(str(error), file=str(contents.path)) from error
    engine.at_once = node.engine.at_once
    host = node.host
    host.started, host.completed, host.failed, host.elements_done = tables["totals"][""]
    slots = slots_of(elements, program)
    over = [instance_of(data, program, load, slots) for data in tables.get("ended", {}).values()]
    host.instances[:] = sorted([*over, *engine.instances.values()], key=lambda instance: instance.key)
    if moved:
        what = ", ".join(f"{old} as {new}" for old, new in moved.items())
        node.host.report("", f"this FAME makes something else of the model, to which the state goes over: {what}")
    node.attach(engine)
    take_unanswered(node, tables)
    node.suspension.restore(tables.get("suspension", {}), epoch_of(node))
    node.waiting.restore(tables.get("people", {}), epoch_of(node))
    if node.acknowledged is not None:
        node.acknowledged.restore(tables, epoch_of(node))
    return tables


def last_time(contents: SegmentContents) -> int:
    """Return the date of the last record (ns since 1970)."""
    return int(contents.last_record()["time"])


# ---- without a journal -----------------------------------------------------------------------------------------------


def save(node: RobotNode, path: Path, header: Mapping[str, Any]) -> None:
    """Write the state of a robot between two stimuli into a file. Raises ConfigError."""
    lost: list[str] = []
    dump = StoredValues(node.mission).dump
    tables = StateTables(node.engine, lambda name, reason: lost.append(f"variable {name}: {reason}"), dump)
    over = [instance for instance in node.instances if instance.status != "running"]
    more = {
        **tables_of(node, epoch_of(node)),
        "ended": {str(each.key): instance_data(each, each.program, dump) for each in over},
    }
    state = tables.changes(more, whole=True)
    if lost:
        raise ConfigError(f"the state cannot be stored: {lost[0]}", file=str(path))
    write_segment(path, header, {"time": epoch_of(node) + node.scheduler.now, **state})


def load(node: RobotNode, contents: SegmentContents) -> None:
    """Restore a loaded robot from a file, and continue it. Raises ConfigError for the state of another program."""
    tables = restored(node, contents)
    follow_cancelled(node, tables)
    set_timers(node, tables)
    go_on(node)
