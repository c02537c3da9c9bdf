"""Every field of an engine's state is in a table, and snapshots, forms and migrations handle it or say why not."""

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import Any

import pytest
from engine_models import (
    Run,
    boundary,
    catch,
    condition,
    dump,
    element,
    gateway,
    handler,
    load,
    message,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

from fame.check.explore.canonical import Forms
from fame.engine import Engine, Program, restore, snapshot
from fame.engine.encoding import decode, encode
from fame.engine.engine_state import EngineState
from fame.engine.migration import MigrationPlan, migrate
from fame.engine.program import UNCOUNTED
from fame.engine.state import Instance, Mailbox, Record, Scope, Wait
from fame.engine.state_fields import (
    COUNTS,
    ENGINE,
    INSTANCE,
    MAILBOX,
    RECORD,
    SCOPE,
    STORED,
    VALUE,
    VARIABLES,
    WAIT,
    FieldCodec,
)
from fame.errors import MissionError

TABLES = {"scopes": SCOPE, "waits": WAIT, "boxes": MAILBOX, "instances": INSTANCE, "engine": ENGINE}
CLASSES = {Scope: SCOPE, Wait: WAIT, Mailbox: MAILBOX, Instance: INSTANCE, Record: RECORD, EngineState: ENGINE}
FOLLOWS: dict[type, set[str]] = {
    Scope: {"counts", "cancelling"},  # of its instance; cancelled scripts count as ended
    Wait: {"alive", "catch"},  # what has ended is not there; of its node, or of an incident
    Mailbox: {"alive", "catch"},
    Record: {"depth"},
    Instance: {"program", "status", "scopes"},  # only running ones are there; scopes are counted
    EngineState: {
        "program", "host", "new_variables", "on_incident", "settled", "at_once", "parameters",  # the host's
        "instances", "ready", "unsettled", "suspensions", "starts_no_more", "restored",  # a list of its own
        "missed",  # a report's
        "_trail", "place", "emit",  # nothing between two stimuli
    },
}  # fmt: skip
"""Attributes in no table: they follow from others, or belong to the host."""
NO_PART_OF_A_FORM = {
    ("scopes", "key"), ("waits", "key"), ("boxes", "key"), ("instances", "key"), ("engine", "counter"),  # numbers
    ("instances", "counts"), ("engine", "untaken"),  # statistics
    ("scopes", "depth"), ("scopes", "mark"), ("scopes", "arms"), ("waits", "arms"), ("scopes", "children"),  # follow
    ("scopes", "instance"), ("instances", "root"),
    ("instances", "error"), ("engine", "continuations"), ("engine", "held"), ("engine", "incidents"),  # not explored
}  # fmt: skip
"""Fields that `canonical` and `revival` ignore."""

# ---- states in which every field has a value -------------------------------------------------------------------------

UNDO = "<compensateEventDefinition/>"
LEAVING = "try:\n    await sleep(9)\nfinally:\n    await sleep(5)"
TWICE = "<multiInstanceLoopCharacteristics><loopCardinality>2</loopCardinality></multiInstanceLoopCharacteristics>"


def undone(activity: str) -> str:
    task = script(f"u_{activity}").replace("<scriptTask", '<scriptTask isForCompensation="true"')
    link = f'<association id="l_{activity}" sourceRef="c_{activity}" targetRef="u_{activity}"/>'
    return boundary(f"c_{activity}", activity, UNDO) + task + link


SUSPENDED = start() + path("s p") + sub(
    "p",
    start("ps"), gateway("parallel", "g"), script("w", "await sleep(100)"), user("go"), throw("ta", signal("A")),
    script("px"), catch("q", properties(queue=3), signal("Q")), catch("r", properties(queue=2), message("R")),
    user("ru"), path("ps g w") + path("g go ta px") + path("g q") + path("g r ru"),
    boundary("bt", "ru", timer("PT2S"), interrupting=False),
    handler("h", start("ht", signal("A")) + user("k") + path("ht k"), resume=True),
)  # fmt: skip
JOINED = "".join([
    start(), gateway("parallel", "g"), gateway("parallel", "j"), user("a"), path("s g a j"), path("g j"),
    gateway("inclusive", "i"), gateway("exclusive", "m"), user("a2"), path("g i"), path("g a2 m i"),
    user("c"), path("g c"), boundary("c1", "c", condition("x > 0"), interrupting=False),
    boundary("c2", "c", condition("x > 5"), interrupting=False),
    boundary("c3", "c", properties(queue=2), signal("BQ"), interrupting=False), user("l", TWICE), path("g l"),
    script("d1"), undone("d1"), sub("d", start("ds"), script("dd"), undone("dd"), path("ds dd")),
    script("d2"), undone("d2"), user("d3"), path("g d1 d d2 d3"),
    sub("n", user("nu"), handler("nh", start("nt", signal("N")) + user("nk") + path("nt nk"))), path("g n"),
    boundary("b1", "n", timer("PT9S")), boundary("b2", "n", timer("PT8S")),
])  # fmt: skip
STARTED = process(
    start() + start("q", properties(queue=3), signal("Q")) + user("u") + path("s u") + path("q u")
    + start("z", timer("PT9S")) + path("z u")
    + element("startEvent", "pm", signal("M"), signal("O"), parallelMultiple="true") + path("pm u")
    + catch("never", message("T")) + path("u never"),
    instances=1,
)  # fmt: skip
FAILED = start() + gateway("parallel", "g") + script("w", LEAVING) + script("f", "await sleep(1)\n1 / 0")
FAILED += path("s g w") + path("g f")


class Sample(Run):
    """A run that knows its text."""

    def __init__(self, text: str, variables: dict[str, Any] | None = None) -> None:
        super().__init__(text, variables)
        self.text = text


@cache
def runs() -> dict[str, Sample]:
    suspended = Sample(SUSPENDED, {"x": 1.5}).run(0).message("R").complete("go").signal("Q").signal("Q").run(3)
    joined = Sample(JOINED, {"x": 1}).run(0).signal("N")
    started = Sample(STARTED).run(0).signal("Q").signal("Q").signal("M").message("T")
    held = Sample(JOINED, {"x": 1}).run(0)
    held.node.engine.hold()
    failed = Sample(FAILED).run(2)
    kept = Sample(start() + script("f", "1 / 0") + path("s f"))
    kept.node.engine.on_incident = lambda wait: None
    return {"suspended": suspended, "joined": joined, "started": started, "held": held, "failed": failed,
            "kept": kept.run()}  # fmt: skip


def data_of(name: str) -> Any:
    return json.loads(json.dumps(snapshot(runs()[name].node.engine, dump=dump)))


SAMPLES = pytest.mark.parametrize("name", ["suspended", "joined", "started", "held", "failed", "kept"])


def restored(program: Program, data: Any, name: str) -> Engine:
    node = runs()[name].node
    return restore(program, data, node.host, node.engine.new_variables, load=load)


def items(data: Any, table: str) -> list[Any]:
    return [data] if table == "engine" else data[table]


FIELDS = pytest.mark.parametrize(
    ("table", "field", "kind"),
    [(table, STORED.get(field, field), kind) for table, fields in TABLES.items() for field, kind in fields.items()],
    ids=lambda each: each if isinstance(each, str) else "",
)  # fmt: skip


# ---- tables and snapshots --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", CLASSES)
def test_every_attribute_is_in_a_table_or_follows_from_others(kind: type) -> None:
    engine = runs()["joined"].node.engine
    sample: Any = (
        next(iter(engine.instances.values())) if kind is Instance else EngineState(engine.program, engine.host)
    )
    attributes = getattr(kind, "__slots__", None) or vars(sample).keys()
    assert {*attributes} - {"hash"} == CLASSES[kind].keys() | FOLLOWS[kind]


@FIELDS
def test_every_field_has_a_value_in_a_sample(table: str, field: str, kind: FieldCodec) -> None:
    found = [item[field] for name in runs() for item in items(data_of(name), table)]
    assert any(found) or (kind is VARIABLES and 0 in found)


@SAMPLES
def test_a_snapshot_comes_back(name: str) -> None:
    data = data_of(name)
    engine = restored(runs()[name].node.engine.program, data, name)
    assert json.loads(json.dumps(snapshot(engine, dump=dump))) == data


# ---- migration -------------------------------------------------------------------------------------------------------


def renamed(data: Any, names: dict[str, str]) -> Any:
    """Data in which keys of nodes are others."""
    if isinstance(data, dict):
        return {names.get(key, key): renamed(value, names) for key, value in data.items()}
    if isinstance(data, list):
        return [renamed(item, names) for item in data]
    return names.get(data, data) if isinstance(data, str) else data


@SAMPLES
def test_a_migration_transfers_every_field(name: str) -> None:
    old = runs()[name].node.engine.program
    text = runs()[name].text
    ids = {node.id for node in old.nodes}
    new = Sample(re.sub(r'"([a-z]\w*)"', lambda found: found[0][:-1] + 'X"' if found[1] in ids else found[0], text))
    names = {key: key.replace(node.id, f"{node.id}X", 1) for key, node in old.by_key.items()}
    data = data_of(name)
    moved, _ = migrate(data, old, new.node.engine.program, MigrationPlan(to={id: f"{id}X" for id in ids}))
    assert moved["program"] == new.node.engine.program.hash
    for instance in data["instances"]:
        instance["counts"][UNCOUNTED] = 0
    expected = renamed(data, names)
    for instance, before in zip(expected["instances"], data["instances"], strict=True):
        instance["error"] = before["error"]  # it names the element that the model had then
    assert {**moved, "program": data["program"]} == expected


@SAMPLES
def test_a_migration_leaves_no_reference_to_what_it_drops(name: str) -> None:
    program, data = runs()[name].node.engine.program, data_of(name)
    for wait in data["waits"]:
        element = program.by_key[wait["node"]].id
        moved, _ = migrate(data, program, program, MigrationPlan(abandon=frozenset({element})))
        moved |= {"continuations": [], "variables": []}
        again = snapshot(restored(program, {**moved, "variables": data["variables"]}, name), dump=dump)
        assert {**json.loads(json.dumps(again)), "variables": []} == moved


# ---- forms -----------------------------------------------------------------------------------------------------------


def forms_of(program: Program) -> Forms:
    return Forms(program, lambda value: json.dumps(encode(value, dump)), lambda text: decode(json.loads(text), load))


def changed(value: Any, kind: FieldCodec, others: list[Any]) -> Iterator[Any]:
    """Other values of a field."""
    if isinstance(value, bool):
        yield not value
    elif kind is VALUE:
        yield value + 1
    elif isinstance(value, list) and value:
        yield value[:-1]
    elif isinstance(value, dict) and value:
        yield dict(list(value.items())[:-1])
    else:
        yield from (other for other in others if other != value)


@FIELDS
def test_a_form_has_every_field_that_is_not_left_out(table: str, field: str, kind: FieldCodec) -> None:
    """Two states that differ in this field alone have different forms."""
    if (table, field) in NO_PART_OF_A_FORM:
        return
    for name in ("suspended", "joined", "started"):
        engine = runs()[name].node.engine
        forms, data = forms_of(engine.program), data_of(name)
        before = forms.walk(restored(engine.program, data, name)).form()[0]
        for place, item in enumerate(items(data, table)):
            others: list[Any] = [*range(len(data["variables"]))]
            if kind is not VARIABLES:
                others = [each[field] for part in TABLES for each in items(data, part) if field in each]
            for value in changed(item[field], kind, others):
                state = data_of(name)
                items(state, table)[place][field] = value
                with suppress(KeyError, AttributeError, AssertionError, MissionError):  # no engine is in such a state
                    if forms.walk(restored(engine.program, state, name)).form()[0] != before:
                        return
    raise AssertionError(f"no form depends on {table}.{field}")


@FIELDS
def test_the_order_of_a_list_is_part_of_the_form_if_it_matters(table: str, field: str, kind: FieldCodec) -> None:
    differs = []
    for name in ("suspended", "joined", "started"):
        engine = runs()[name].node.engine
        forms, data = forms_of(engine.program), data_of(name)
        before = forms.walk(restored(engine.program, data, name)).form()[0]
        for item in items(data, table):
            if isinstance(item[field], list) and len(item[field]) > 1 and kind is not COUNTS:
                state = data_of(name)
                other = next(each for each in items(state, table) if each.get("key") == item.get("key"))
                other[field].reverse()
                after = forms.walk(restored(engine.program, state, name)).form()[0]
                differs.append(after != before)
    assert any(differs) == kind.ordered or not differs


@pytest.mark.parametrize("name", ["suspended", "joined", "started"])
def test_an_engine_comes_back_from_its_form(name: str) -> None:
    engine = runs()[name].node.engine
    forms = forms_of(engine.program)
    form, _ = forms.walk(engine).form()
    again = forms.revived(form, runs()[name].node.host, engine.new_variables, moves=1000)
    assert forms.walk(again).form()[0] == form
