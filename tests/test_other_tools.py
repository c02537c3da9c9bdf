"""Models in the style of other tools: each is read and runs as drawn, or is refused with a reason; never a traceback.

The files of tests/other_tools are our own, written as the tools that they are named after write theirs: prefixes,
encodings, ids, vendors' extensions, diagrams, languages. A tool that has a second file there is shown with what keeps
its models from running (Java, Groovy, MVEL ...).
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import pytest
from lxml import etree
from test_damaged_files import damage

import fame
from fame.bpmn import read_bytes
from fame.bpmn.draw.diagram import draw
from fame.bpmn.model import Definitions
from fame.bpmn.split import split
from fame.check import check
from fame.cli import main
from fame.errors import FameError, ModelError

FOLDER = Path(__file__).parent / "other_tools"
FILES = sorted(path for path in FOLDER.iterdir() if path.suffix in (".bpmn", ".xml"))

# ---- what runs -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Story:
    """A run of a process: what is done to it, and how often each element (by its name) was completed.

    `steps` are ``+name`` for a message or signal and ``name`` for a task that somebody completes, with values. `until`
    is where simulated time stands meanwhile, in seconds; None: where nothing can move.
    """

    file: str
    process: str
    visits: str
    steps: tuple[tuple[str, Mapping[str, Any]], ...] = ()
    variables: Mapping[str, Any] = field(default_factory=dict)
    until: float | None = 0.0
    status: str = "completed"


def done(name: str, **values: Any) -> tuple[str, Mapping[str, Any]]:
    return name, values


STORIES = [
    Story("signavio.bpmn", "Mäher", "Auftrag erhalten, Fläche prüfen, gemäht?, Bericht",
          (done("+Auftrag_erhalten"), done("Fläche prüfen", fertig=True))),
    Story("aris.bpmn", "Lager", "Beginn, Palette übergeben, Bereit"),
    Story("aris.bpmn", "Fahrzeug", "Los, Größe.auf, Palette bereit, Anhänger anschließen, Größe.zu, _Fertig",
          (done("+palette_bereit"), done("Anhänger anschließen"))),
    Story("bpmn_io.bpmn", "", "StartEvent_1, Event_0in, Look around, Event_0out, Search the field, found",
          (done("Look around"),)),
    Story("bpmn_io.bpmn", "", "StartEvent_1, Event_0in, 30 s, gone home", until=None),
    Story("bizagi.bpmn", "Proceso principal",
          "Inicio, Ir a la estación siguiente, Ir a la estación siguiente, Ir a la estación siguiente, ¿Más?, Fin"),
    Story("jbpm.bpmn", "Carrier", "_S01, Weigh the load, _G01, dock, _E01",
          (done("Weigh the load", load=7), done("+dock_free"))),
    Story("jbpm.bpmn", "Carrier", "_S01, Weigh the load, _G01, _W02, _E02", (done("Weigh the load", load=7),),
          until=60.0),
    Story("flowable.bpmn", "surveyFields", "startnoneevent1, Plan, any, begin, See it, end, begin, See it, end, "
          "Survey each, Survey each, done",
          (done("Plan", approved=True, fields=["a", "b"], weight=3), done("See it"), done("See it"))),
    Story("flowable.bpmn", "surveyFields", "startnoneevent1, Plan, any, done",
          (done("Plan", approved=True, fields=[], weight=3),)),
    Story("activiti.bpmn20.xml", "beat", "start, Sum, Ring, Ring, Ring, end",
          (done("Ring"),) * 3, variables={"a": 1, "b": 2}),
    Story("visual_paradigm.bpmn", "Courier", "Parcel, Start2, Carry, Delivered, Deliver, End",
          (done("+parcel"), done("Carry", stuck=False))),
    Story("visual_paradigm.bpmn", "Courier", "Parcel, Start2, Carry, Stuck, U.qfW0GAqBwCNA7g, Help!",
          (done("+parcel"), done("Carry", stuck=True))),
    Story("enterprise_architect.bpmn", "Guard", "EAID_0A4C91B7_0014_43c1, EAID_0A4C91B7_0019_43c1, Walk, "
          "Walk the rounds \u2013 twice, EAID_0A4C91B7_0019_43c1, stop, End", (done("Walk"), done("+stop"))),
    Story("adonis.bpmn", "_prüfen", "Start, Wärme messen, Messen, Was tun?, Kühlen", (done("Wärme messen", wärme=90),)),
    Story("adonis.bpmn", "_messen", "Wärme messen", (done("Wärme messen", wärme=90),)),
    Story("ibm.bpmn", "", "Start, Look into → crate, End", (done("Look into → crate"),)),
    Story("eclipse.bpmn", "Porter", "Order, Ring, Rang", (done("+order", data="7"),)),
    Story("yaoqiang.bpmn", "Rover", "Start, Gate, Low, Charge, End", (done("+battery_low"), done("Charge"))),
    Story("yaoqiang.bpmn", "Rover", "Start, Gate, Late, End", until=None),
    Story("bizagi_utf16.bpmn", "Armazém", "Pedido, Separar peças, Id_e", (done("+pedido"), done("Separar peças"))),
    Story("oracle.bpmn", "", "s, g, Grip", variables={"x": 5}),
    Story("oracle.bpmn", "", "s, g, Wait", (done("Wait"),), variables={"x": 1}),
    Story("conversation.bpmn", "A", "sa, Ask"),
    Story("conversation.bpmn", "B", "sb, eb", (done("+sb"),)),
    Story("sparx.bpmn", "", "EAID_{1A-2B}, Greifen, Greifen, Ende"),
    Story("jbpm_javascript.bpmn", "", "_1, Count, Look, _7", (done("Look", r=3),), variables={"count": 1}),
    Story("signavio_timer.bpmn", "", "sid-a, Warten, sid-x, sid-e", (done("Warten"),)),
    Story("signavio_timer.bpmn", "", "sid-a, 5 min, sid-x, sid-e", until=None),
    Story("visio.bpmn", "", "a, t"),
    Story("blueworks.bpmn", "", "Case, U, V", (done("U"), done("V"))),
    Story("no_ids.bpmn", "", "a, b, c"),
]  # fmt: skip


@pytest.mark.parametrize("story", STORIES, ids=lambda story: f"{story.file}-{story.process}")
def test_it_runs_as_it_is_drawn(story: Story) -> None:
    assert run(story, fame.read(FOLDER / story.file)) == (story.status, visits_of(story))


@pytest.mark.parametrize("story", STORIES, ids=lambda story: f"{story.file}-{story.process}")
def test_its_part_of_the_split_file_runs_likewise(story: Story) -> None:
    definitions = fame.read(FOLDER / story.file)
    if not definitions.participants and (meant := definitions.only_executable) is None:
        with pytest.raises(ModelError, match=r"it has 2 processes and no pool for them"):
            split(definitions)
        return
    if not definitions.participants and meant is not None and meant.id != story.process:
        return  # that is called, or another one
    parts = {part.name: part for part in split(definitions)}
    part = parts[story.process] if definitions.participants else next(iter(parts.values()))
    assert run(story, read_bytes(part.source, file=part.filename)) == (story.status, visits_of(story))


def visits_of(story: Story) -> Counter[str]:
    return Counter(story.visits.split(", "))


def run(story: Story, definitions: Definitions) -> tuple[str, Counter[str]]:
    """How its instance ended, and the names of the elements completed."""
    services = {"ring": lambda variables: None}
    sim = fame.Simulation(definitions, story.process or None, dict(story.variables), services=services)
    nodes = [node for process in definitions.processes for node in process.body.walk()]
    sim.run(story.until if story.until is None else 0.0)
    for name, values in story.steps:
        if name.startswith("+"):
            sim.signal(name[1:], dict(values) or None)
        else:
            sim.complete(next(node.id for node in nodes if node.label == name and node.id in waiting(sim)), values)
    sim.run(story.until)
    (instance,) = sim.instances
    assert instance.error is None
    assert list(instance.waiting) == []
    labels = {node.id: node.label for node in nodes}
    found: Counter[str] = Counter()
    for id, times in instance.visits.items():
        found[labels[id]] += times
    return instance.status, found


def waiting(sim: fame.Simulation) -> list[str]:
    return [id for instance in sim.instances for id in instance.waiting]


# ---- what does not ---------------------------------------------------------------------------------------------------

_LANGUAGES = "expected python (the default), javascript, ${...} or =..."
REFUSED = {
    "bonita.bpmn": f":16: \"low\" (_HbIkUE3cEeqW): language 'http://groovy.codehaus.org/': {_LANGUAGES}",
    "jbpm_java.bpmn": f":10: _2-_3: language 'http://www.java.com/java': {_LANGUAGES}",
    "jbpm_mvel.bpmn": f":10: _2-_3: language 'http://www.mvel.org/2.0': {_LANGUAGES}",
    "flowable_groovy.bpmn": f":6: \"Add\" (add): language 'groovy': {_LANGUAGES}",
    "flowable_java.bpmn": ':5: "Motor" (motor): it runs the Java class org.example.MotorDelegate; '
    "FAME does not run Java: use a script task, or name a registered operation",
    "flowable_http.bpmn": ":1: h: it is a vendor-specific task of type http; use a script task, or name a "
    "registered operation",
    "ibm_script.bpmn": f":7: \"Weigh\" (bpdid:2): language 'text/x-javascript': {_LANGUAGES}",
    "trisotech.bpmn": ':6: "Confirm" (_c): it calls the <globalUserTask> _g1: make it a process with that task in it',
    "choreography.bpmn": ": name the process to run: the file has none",
    "beta.bpmn": ":2: the root is <definitions> of namespace http://schema.omg.org/spec/BPMN/2.0: expected "
    "<definitions> of http://www.omg.org/spec/BPMN/20100524/MODEL",
    "xpdl.bpmn": ":2: the root is <Package> of namespace http://www.wfmc.org/2009/XPDL2.2: expected <definitions> of "
    "http://www.omg.org/spec/BPMN/20100524/MODEL",
}
"""What is said of a file that cannot be run, after its name."""


@pytest.mark.parametrize(("name", "said"), REFUSED.items(), ids=REFUSED.keys())
def test_it_is_refused_by_file_line_and_element(name: str, said: str) -> None:
    with pytest.raises(ModelError) as caught:
        fame.Simulation(fame.read(FOLDER / name))
    assert str(caught.value).startswith(f"{FOLDER / name}{said}")
    assert "\n" not in str(caught.value)


def test_every_file_is_run_or_refused() -> None:
    assert {path.name for path in FILES} == {story.file for story in STORIES} | set(REFUSED)


# ---- what is said of them --------------------------------------------------------------------------------------------

ROS = "expected ASCII letters, digits and _, not starting with a digit"
WARNINGS = {
    "aris.bpmn": [],
    "bizagi.bpmn": [
        "always takes it: give it one, or mark it as the default",
        "always takes it: give it one, or mark it as the default",
        f"/Proceso principal is not a valid ROS 2 namespace: {ROS}",
    ],
    "choreography.bpmn": ["<choreography> has no effect"],
    "flowable.bpmn": [
        "assignee='${initiator}' has no effect: expected names, not an expression",
        "any answer is accepted: its form plan-form is in no .form file beside the model, and not embedded",
        "flowable:executionListener is not run: FAME has no listeners",
    ],
    "signavio.bpmn": [
        f"/Mäher is not a valid ROS 2 namespace: {ROS}",
    ],
}  # fmt: skip


@pytest.mark.parametrize(("name", "said"), WARNINGS.items(), ids=WARNINGS.keys())
def test_what_is_doubtful_in_it_is_told(name: str, said: Sequence[str]) -> None:
    warnings = [one.text for one in check(fame.read(FOLDER / name)) if one.level == "warning"]
    assert len(warnings) == len(said)
    assert all(text.endswith(expected) for text, expected in zip(warnings, said, strict=True))


def test_a_multiplicity_of_one_is_one_robot() -> None:
    assert [pool.multi_instance for pool in fame.read(FOLDER / "aris.bpmn").participants] == [False, False]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
@pytest.mark.parametrize("command", ["check", "draw", "split"])
def test_every_command_does_it_or_says_in_one_line_why_not(
    command: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = {"check": [], "draw": ["-o", str(tmp_path / "drawn.svg")], "split": ["-o", str(tmp_path / "parts")]}
    code = main([command, str(path), *output[command]])
    said = capsys.readouterr()
    if command == "check":
        assert said.err == ""
        assert code == (1 if ": error: " in said.out else 0)
        assert path.name not in REFUSED or code == 1
    elif code:
        assert code == 2
        assert said.err.startswith(f"fame: error: {path}:")
        assert said.err.count("\n") == 1
    else:
        written = [Path(line).read_bytes() for line in said.out.splitlines()]
        assert written
        assert all(etree.fromstring(content) is not None for content in written)


# ---- what somebody did to them ---------------------------------------------------------------------------------------

RUNS = 40
"""Damaged files of each seed."""


def noise(source: bytes, random: Random) -> bytes:
    """The file with a few bytes lost, changed or put in."""
    content = bytearray(source)
    for _ in range(random.choice([1, 2, 5])):
        place = random.randrange(len(content))
        content[place : place + random.choice([0, 1, 1, 40])] = random.randbytes(random.choice([0, 1, 1, 3]))
    return bytes(content)


def broken(source: bytes, random: Random) -> bytes:
    """The file with a few elements or attributes lost, changed or in another place."""
    root = etree.fromstring(source)
    for _ in range(random.choice([1, 1, 2])):
        damage(root, random)
    return etree.tostring(root, encoding=random.choice(["UTF-8", "UTF-16", "ASCII"]))


@pytest.mark.long_but("0-*")
@pytest.mark.parametrize("kind", [noise, broken])
@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_one_is_read_or_refused_in_one_line(kind: Callable[[bytes, Random], bytes], seed: int) -> None:
    random = Random(seed)
    refusals = [text for _ in range(RUNS) for text in handled(kind(random.choice(FILES).read_bytes(), random))]
    assert len(refusals) > RUNS / 10
    assert all(text.startswith("damaged.bpmn") and "\n" not in text for text in refusals)


def handled(source: bytes) -> list[str]:
    """Does all that can be done with a file, but for running it. Returns why it was refused."""
    try:
        definitions = read_bytes(source, file="damaged.bpmn")
    except ModelError as error:
        return [str(error)]
    findings = [str(one) for one in check(definitions) if one.level == "error"]
    for doing in (draw, split, *(running(process.id) for process in definitions.processes)):
        try:
            doing(definitions)
        except FameError as error:
            findings.append(str(error))
    return findings


def running(process: str) -> Callable[[Definitions], object]:
    """Compiles a process, as for a run."""
    return lambda definitions: fame.Simulation(definitions, process)
