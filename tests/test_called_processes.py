"""Where called processes are found, and that the parts of a split model call the same ones."""

import random
import shutil
from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document
from test_splitter_node import Farm

import fame
from fame.bpmn import read_bytes
from fame.bpmn.library import BUILT_IN, Library
from fame.bpmn.split import split
from fame.check import check
from fame.check.scope import find_scope
from fame.errors import FameError, ModelError
from fame.scenario import Scenario, run as scenario_run
from fame.view.catalogue import Catalogue

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.yaml"))
RUNS = [path for path in EXAMPLES if "\nmodel:" in f"\n{path.read_text()}"]


def says(text: str, id: str = "P", calls: tuple[str, ...] = (), extra: str = "", limit: int = 12) -> str:
    """A process that adds `text` to the list `trail` and then makes its calls, unless the list is `limit` long.

    In the ids of its elements, @ stands for its number in the file.
    """
    names = [f"c{number}@" for number in range(len(calls))]
    steps = "".join(
        f'<callActivity id="{one}" calledElement="{name}"/>' for one, name in zip(names, calls, strict=True)
    )
    ways = zip(["g@", *names], [*names, "e@"], strict=True)
    condition = f"<conditionExpression>len(trail) &lt; {limit}</conditionExpression>"
    flows = "".join(
        f'<sequenceFlow id="f{a}" sourceRef="{a}" targetRef="{b}">{condition if a == "g@" else ""}</sequenceFlow>'
        for a, b in ways
    )
    return (
        f'<process id="{id}" isExecutable="true">{extra}<startEvent id="s@"/>'
        f'<scriptTask id="t@" scriptFormat="python"><script>trail = [*trail, \'{text}\']</script></scriptTask>'
        '<sequenceFlow id="a@" sourceRef="s@" targetRef="t@"/><sequenceFlow id="b@" sourceRef="t@" targetRef="g@"/>'
        f'<exclusiveGateway id="g@" default="d@"/>{steps}<endEvent id="e@"/>{flows}'
        '<sequenceFlow id="d@" sourceRef="g@" targetRef="e@"/></process>'
    )


def file(*processes: str, roots: str = "", pool: bool = False) -> str:
    numbered = (one.replace("@", str(number or "")) for number, one in enumerate(processes))
    return document((POOL if pool else "") + "".join(numbered) + roots)


POOL = '<collaboration id="C"><participant id="Pool" name="ROBOT" processRef="P"/></collaboration>'


def write(path: Path, *processes: str) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text(file(*processes, pool=path.name == "m.bpmn"))
    return path


def trail(model: Any, library: Any = ()) -> str:
    """What a run of process ``P`` says."""
    simulation = fame.Simulation(model, "P", {"trail": []}, library=library).run()
    return " ".join(simulation.instances[0].variables["trail"])


def part_of(model: Path, library: Any = ()) -> fame.bpmn.model.Definitions:
    return read_bytes(split(model, Library(library))[0].source, file="part.bpmn")


def refused(model: Path, library: Any = ()) -> str:
    with pytest.raises(ModelError) as caught:
        trail(model, library)
    with pytest.raises(ModelError, match=caught.value.text.split("(")[0][:60]):
        split(model, Library(library))
    return str(caught.value)


# ---- the rule --------------------------------------------------------------------------------------------------------


def test_a_process_is_found_by_its_id_whatever_its_file_is_called(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Explore", "GoTo_sub-process")))
    write(tmp_path / "my_explore.bpmn", says("mine", "Explore"), says("other", "Q"))
    write(tmp_path / "GoTo_sub-process.bpmn", says("go", "Go_To"))
    assert trail(model) == trail(part_of(model)) == "m mine go"


@pytest.mark.parametrize("first", range(5))
def test_the_first_level_that_has_it_counts(tmp_path: Path, first: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.bpmn.library.BUILT_IN", (tmp_path / "own",))
    places = ["m.bpmn", "given/a.bpmn", "b.bpmn", "library/c.bpmn", "own/d.bpmn"]
    own = {place: says(place, "Helper") for place in places[first:]}
    model = write(tmp_path / "m.bpmn", says("m", calls=("Helper",)), own.pop("m.bpmn", ""))
    write(tmp_path / "given" / "Helper.bpmn", says("by name", "Other")) if first > 1 else None
    (tmp_path / "given").mkdir(exist_ok=True)
    for place, process in own.items():
        write(tmp_path / place, process)
    assert trail(model, tmp_path / "given") == f"m {'by name' if first > 1 else places[first]}"


def test_two_that_may_be_meant_are_an_error_that_names_both_if_one_is_called(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Helper",)))
    write(tmp_path / "a.bpmn", says("a", "Helper"), says("a", "Q"))
    write(tmp_path / "b.bpmn", says("b", "Helper"), says("b", "Q"))
    text = refused(model)
    assert "a.bpmn" in text
    assert "b.bpmn" in text
    write(tmp_path / "b.bpmn", says("b", "Q"))
    (tmp_path / "c.bpmn").symlink_to("a.bpmn")  # the same file
    assert trail(model) == "m a"


@pytest.mark.parametrize(
    ("calls", "roots"),
    [
        ({"A": "E", "B": ""}, ["A"]),  # E, of another file, calls B
        ({"A": "BC", "B": "", "C": "B"}, ["A"]),
        ({"A": "B", "B": "AC", "C": ""}, ["A or B"]),  # the first of the cycle
    ],
)
def test_a_process_that_another_one_calls_does_not_start_by_itself(
    calls: dict[str, str], roots: list[str], tmp_path: Path
) -> None:
    write(tmp_path / "E.bpmn", says("e", "E", calls=("B",)))
    for order in permutations(calls):
        write(tmp_path / "a.bpmn", *(says(name, name, calls=tuple(calls[name])) for name in order))
        scope = find_scope(fame.read(tmp_path / "a.bpmn"), Library(tmp_path))
        first = min("AB", key=order.index)
        assert sorted(root.bpmn.id for root in scope.roots) == [root.replace("A or B", first) for root in roots], order


def test_of_several_the_file_of_that_name_is_called_with_a_warning(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("TakeOff", "Hover")))
    write(tmp_path / "TakeOff.bpmn", says("take off", "TakeOff"))
    write(tmp_path / "Land.bpmn", says("land", "TakeOff"), says("other", "Q"))
    write(tmp_path / "Hover.bpmn", says("hover", "Process_1"))
    write(tmp_path / "Copy.bpmn", says("copy", "Hover"))
    assert trail(model) == trail(part_of(model)) == "m take off hover"
    found = [(one.element, one.text) for one in check(model, library=Library()) if one.level == "warning"]
    assert [(element, text.replace(f"{tmp_path}/", "")) for element, text in found] == [
        ("c0", "calls 'TakeOff' of the file of that name, which Land.bpmn has, too"),
        ("c1", "calls 'Hover' of the file of that name, which Copy.bpmn has, too"),
    ]


def test_a_file_that_nobody_calls_may_be_broken(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Helper",)))
    helper = write(tmp_path / "h.bpmn", says("h", "Helper"))
    for number, content in enumerate(
        ("", "<not", "<definitions/>", document(says("x", "X") * 2), helper.read_text()[:600])
    ):
        (tmp_path / f"broken{number}.bpmn").write_text(content)
    (tmp_path / "gone.bpmn").symlink_to("nowhere")
    (tmp_path / "folder.bpmn").mkdir()
    assert trail(model) == "m h"


def test_a_broken_file_does_not_hide_that_a_name_was_not_found(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Helper",)))
    (tmp_path / "broken.bpmn").write_text("<not")
    assert "broken.bpmn" in refused(model).partition("cannot be read")[2]


def test_a_broken_file_that_has_the_name_is_not_passed_over_for_a_later_level(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Explore",)))
    mine = write(tmp_path / "mine.bpmn", says("mine", "Explore"))
    mine.write_text(mine.read_text()[:-3])
    assert "mine.bpmn" in refused(model)


def test_a_file_named_like_the_call_that_has_several_others_is_told_if_nothing_is_found(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Helper",)))
    write(tmp_path / "Helper.bpmn", says("a", "A"), says("b", "B"))
    assert "Helper.bpmn has no process 'Helper': it has A, B" in refused(model)


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: text.replace("<", "<bpmn:").replace("<bpmn:/", "</bpmn:").replace("xmlns=", "xmlns:bpmn="),
        lambda text: text.replace('id="Helper"', "isClosed='false'\n  id = 'Helper'"),
        lambda text: text.replace('<process id="Helper"', '<process name="a > b" id="H&#101;lper"'),
        lambda text: f'<?xml version="1.0" encoding="UTF-16"?>{text}'.encode("utf-16"),
    ],
    ids=["prefix", "spaces", "escaped", "utf-16"],
)
def test_its_id_is_found_however_it_is_written(tmp_path: Path, edit: Callable[[str], Any]) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Helper",)))
    (tmp_path / "not.bpmn").write_text(file(f"<!--{says('no', 'Helper')}-->" + says("no", "No")))
    written = edit(file(says("h", "Helper")))
    (tmp_path / "h.bpmn").write_bytes(written if isinstance(written, bytes) else written.encode())
    assert trail(model) == trail(part_of(model)) == "m h"


def test_each_file_means_its_own_processes(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Work", "Helper")), says("mine", "Helper"))
    write(tmp_path / "library" / "w.bpmn", says("w", "Work", calls=("Helper",)), says("its own", "Helper"))
    part = part_of(model)
    assert trail(model) == trail(part) == "m w its own mine"
    assert [process.id for process in part.processes] == ["P", "Helper", "Work", "Helper_2"]


def test_a_file_that_wraps_what_it_is_named_after_does_not_call_itself(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("GoTo",)))
    write(tmp_path / "GoTo.bpmn", says("careful", "Go", calls=("GoTo",)))
    write(tmp_path / "library" / "g.bpmn", says("plain", "GoTo"))
    assert trail(model) == trail(part_of(model)) == "m careful plain"


def test_a_note_and_the_page_say_what_comes_from_the_library_of_fame(tmp_path: Path) -> None:
    model = write(tmp_path / "m.bpmn", says("m", calls=("Wait", "Helper", "Turn")))
    write(tmp_path / "h.bpmn", says("h", "Helper"))
    assert "FAME's own library supplies Turn, Wait" in [one.text for one in check(model) if one.level == "note"]
    definitions, library = fame.read(model), Library()
    files = [home for home, _ in library.closure(definitions, definitions.processes[0])]
    recorded = [read_bytes(one.source, file=Path(one.file).name) for one in files]
    for catalogue in (Catalogue(files, library.find), Catalogue(recorded)):
        sources = {one["id"]: one["source"] for one in catalogue.elements_json() if "source" in one}
        assert [sources[id] for id in ("c0", "c1", "c2")] == [
            "calls Wait of FAME's own library", "calls Helper of h.bpmn", "calls Turn of FAME's own library",
        ]  # fmt: skip
    (tmp_path / "library").mkdir()
    for folder in BUILT_IN:
        shutil.copytree(folder, tmp_path / "library", dirs_exist_ok=True)
    assert not [one for one in check(model) if "FAME's own" in one.text]


def test_a_model_that_was_sent_has_no_files_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "Helper.bpmn", says("h", "Helper"))
    write(tmp_path / "ROBOT.bpmn", says("r", "Other"))
    model = file(says("m", calls=("Helper",)), pool=True)
    farm = Farm("ROBOT")
    farm.send("ROBOT", model)
    farm.pass_time(3)
    assert "found neither a process of this file nor Helper.bpmn in the built-in library" in " ".join(
        report.reason for report in farm.said
    )
    farm.splitter()
    farm.diagram(model)
    farm.pass_time(3)
    assert "nor Helper.bpmn in the built-in library" in " ".join(farm.lines)


# ---- a whole and its parts -------------------------------------------------------------------------------------------


def outcome(model: Any, library: Any, variables: dict[str, Any]) -> tuple[Any, ...]:
    """All that a run of ``P`` shows: how it ends, its variables, its topics with their types."""
    try:
        simulation = fame.Simulation(model, "P", variables, library=library).run()
    except FameError as error:
        return (type(error), error.text.replace("'P'", "P"))
    (instance,) = simulation.instances
    values = {name: value for name, value in instance.variables.items() if not name.startswith("__")}
    topics = sorted((info.name, tuple(info.types)) for info in simulation.middleware.graph())
    return instance.status, getattr(instance.error, "code", None), values, topics


class Drawn:
    """Random files that call each other, with the same ids in all of them, and what a run of them says."""

    NAMES = ("Helper", "Work", "Step", "Go_To")
    FOLDERS = ("", "library", "given")

    def __init__(self, seed: int, folder: Path) -> None:
        self.draw, self.folder = random.Random(seed), folder
        self.files: dict[str, dict[str, tuple[str, ...]]] = {"m.bpmn": {"P": self.calls(3)} | self.processes(1)}
        for number in range(self.draw.randint(1, 6)):
            place = Path(self.draw.choice(self.FOLDERS)) / f"{self.draw.choice((*self.NAMES, f'f{number}'))}.bpmn"
            self.files.setdefault(str(place), self.processes(self.draw.randint(1, 3)))
        (folder / "given").mkdir(parents=True)
        for place, processes in self.files.items():
            self.write(place, processes)

    def calls(self, most: int) -> tuple[str, ...]:
        return tuple(self.draw.choice(self.NAMES) for _ in range(self.draw.randint(0, most)))

    def processes(self, most: int) -> dict[str, tuple[str, ...]]:
        return {self.draw.choice((*self.NAMES, "Other")): self.calls(2) for _ in range(most)}

    def write(self, place: str, processes: dict[str, tuple[str, ...]]) -> None:
        """The file, with signals, errors and conditions that are what their ids or the whole file say."""
        draw, content = self.draw, list[str]()
        for id, calls in processes.items():
            events = draw.choice(("", '<signalEventDefinition signalRef="Sig"/>', "<signalEventDefinition/>"))
            handler = '<subProcess id="h@" triggeredByEvent="true"><startEvent id="x@">{}</startEvent></subProcess>'
            content.append(says(f"{place}:{id}", id, calls, handler.format(events) if events else ""))
        names = draw.choice(('name="news"', f'name="{Path(place).stem}"', ""))
        text = file(*content, roots=f'<signal id="Sig" {names}/>', pool=place == "m.bpmn")
        if draw.random() < 0.3:
            text = text.replace("<definitions ", '<definitions expressionLanguage="feel" ').replace("len(", "count(")
        if draw.random() < 0.3:
            text = text.replace('calledElement="', 'xmlns:own="http://fame" calledElement="own:')
        if draw.random() < 0.3:
            text = text.replace("<", "<b:").replace("<b:/", "</b:").replace("xmlns=", "xmlns:b=")
        path = self.folder / place
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)

    def found(self, home: str, name: str) -> tuple[str, str] | None:
        """The process that a file means, by the rule; None if there is none or not only one."""
        if name in self.files[home]:
            return home, name
        beside = Path(home).parent
        for folder in (Path("given"), beside, beside / "library"):
            level = {place: ids for place, ids in self.files.items() if Path(place).parent == folder}
            by_id = [(place, name) for place, ids in level.items() if name in ids]
            alone = [(place, next(iter(ids))) for place, ids in level.items()
                     if Path(place).stem == name and len(ids) == 1 and place != home]  # fmt: skip
            both = [*by_id, *(one for one in alone if one not in by_id)]
            best = [one for one in both if Path(one[0]).stem == name] if len(both) > 1 else both
            if both:
                return best[0] if len(best) == 1 else None
        return None

    def said(self) -> list[str] | None:
        """What a run says; None if a call leads nowhere."""
        said: list[str] = []
        seen, waiting = set(), [("m.bpmn", "P")]
        for home, id in waiting:
            if (home, id) not in seen:
                seen.add((home, id))
                targets = [self.found(home, name) for name in self.files[home][id]]
                if None in targets:
                    return None
                waiting += [target for target in targets if target is not None]

        def visit(home: str, id: str) -> None:
            said.append(f"{home}:{id}")
            for name in self.files[home][id] if len(said) < 12 else ():
                visit(*(self.found(home, name) or ("", "")))

        visit("m.bpmn", "P")
        return said


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(5))
def test_random_files_that_call_each_other_run_as_their_parts_do(part: int, tmp_path: Path) -> None:
    ran = 0
    for seed in range(part, 100, 5):
        drawn = Drawn(seed, tmp_path / str(seed))
        model, library, said = drawn.folder / "m.bpmn", drawn.folder / "given", drawn.said()
        whole = outcome(model, library, {"trail": []})
        if said is None:
            assert whole[0] is ModelError, seed
            with pytest.raises(ModelError):
                split(model, Library(library))
            continue
        ran += 1
        assert whole[2]["trail"] == said, seed
        (part,) = split(model, Library(library))
        assert outcome(read_bytes(part.source, file="p.bpmn"), (), {"trail": []}) == whole, seed
    assert ran > 4


def test_a_part_without_a_pool_says_which_of_its_processes_is_to_be_run(tmp_path: Path) -> None:
    (tmp_path / "p.bpmn").write_text(file(says("p", calls=("Helper",))))
    write(tmp_path / "h.bpmn", says("h", "Helper"))
    part = part_of(tmp_path / "p.bpmn")
    assert [process.executable for process in part.processes] == [True, False]
    assert trail(part) == "p h"


@pytest.mark.long
@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_each_example_runs_as_its_parts_do(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def shown(result: Any) -> tuple[Any, ...]:
        robots = [
            (one.name, one.summary, one.elements, [str(error.text) for error in one.errors]) for one in result.robots
        ]
        return result.status, result.simulated, robots, result.world

    seconds = 10 if path.stem == "reassembly" else 20  # an arm takes long to compute, and calls all by then
    scenario = Scenario.load(path, duration=seconds)
    folder = Path(scenario.definitions.file).parent  # of files that monitors read
    whole = shown(scenario.run())
    parts = {
        part.process_id: read_bytes(part.source, file=str(folder / part.filename))
        for part in split(scenario.definitions, scenario.library)
    }
    real = scenario_run.make_mission

    def make_part(definitions: Any, process: Any, *, library: Library, **options: Any) -> Any:
        part = parts[process.id]
        return real(part, part.processes[0], library=Library(), **options)

    monkeypatch.setattr(scenario_run, "make_mission", make_part)
    assert shown(Scenario.load(path, duration=seconds).run()) == whole


# ---- depth -----------------------------------------------------------------------------------------------------------


def chain(calls: int, nested: int, inside: str = "") -> list[str]:
    """Processes P, P1, P2 ... each of which calls the next one, inside `nested` sub-processes."""
    found = []
    for number in range(calls + 1):
        end = f'<scriptTask id="end" scriptFormat="feel"><script>{"(" * 40}1{")" * 40}</script></scriptTask>'
        text = f'<callActivity id="c{number}" calledElement="P{number + 1}"/>' if number < calls else end
        for level in range(nested, 0, -1):
            text = f'<subProcess id="s{number}_{level}">{inside}{text}</subProcess>'
        found.append(f'<process id="P{number or ""}" isExecutable="true">{text}</process>')
    return found


@pytest.mark.long_but("12*one file")
@pytest.mark.parametrize("apart", [False, True], ids=["one file", "a file each"])
@pytest.mark.parametrize(
    ("calls", "nested", "element"),
    [(120, 0, ""), (59, 1, ""), (121, 0, "c120"), (60, 1, "s60_1"), (400, 0, "c120"), (9, 60, "s1_60")],
)
def test_calls_and_sub_processes_are_at_most_120_deep_together(
    calls: int, nested: int, element: str, apart: bool, tmp_path: Path
) -> None:
    processes = chain(calls, nested)
    path = tmp_path / "P.bpmn"
    path.write_text(document("".join(processes[:1] if apart else processes)))
    for number, text in enumerate(processes[1:] if apart else (), 1):
        (tmp_path / f"P{number}.bpmn").write_text(document(text))
    errors = [one for one in check(fame.read(path)) if one.level == "error"]
    if element:
        with pytest.raises(ModelError, match="expected at most 120 calls and sub-processes inside each other") as found:
            fame.Simulation(fame.read(path), process="P")
        assert [str(one).replace(" error:", "") for one in errors] == [str(found.value)]
        assert f": {element}: " in str(found.value)
    else:
        simulation = fame.Simulation(fame.read(path), process="P")
        simulation.run()
        assert not errors
        assert simulation.instances[0].status == "completed"


@pytest.mark.parametrize(
    "kind",
    [
        '<multiInstanceLoopCharacteristics isSequential="true"><loopCardinality>1</loopCardinality>'
        "</multiInstanceLoopCharacteristics>",
        '<ioSpecification><inputSet/><outputSet/></ioSpecification><standardLoopCharacteristics loopMaximum="1"/>',
    ],
    ids=["multi-instance", "loop"],
)
def test_what_repeats_may_be_as_deep(kind: str) -> None:
    definitions = read_bytes(document("".join(chain(59, 1, kind))).encode(), file="deep.bpmn")
    assert not [one for one in check(definitions) if one.level == "error"]
    simulation = fame.Simulation(definitions, process="P")
    simulation.run()
    assert simulation.instances[0].status == "completed"


@pytest.mark.long
def test_a_process_that_is_called_late_and_early_is_as_deep_as_where_it_is_called_first() -> None:
    """P calls P400 first, then P399 and so on: each is compiled before the one that calls it again."""
    processes = chain(400, 0)
    early = "".join(f'<callActivity id="e{number}" calledElement="P{number}"/>' for number in range(400, 0, -1))
    processes[0] = f'<process id="P" isExecutable="true">{early}</process>'
    definitions = read_bytes(document("".join(processes)).encode(), file="deep.bpmn")
    assert not [one for one in check(definitions) if one.level == "error"]
    fame.Simulation(definitions, process="P")


AGAIN = """<process id="P" isExecutable="true"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>
  <scriptTask id="t"><script>n = n + 1</script></scriptTask>
  <boundaryEvent id="b" attachedToRef="t"><compensateEventDefinition/></boundaryEvent>
  <scriptTask id="u" isForCompensation="true"><script>undone = undone + 1</script></scriptTask>
  <association id="a" sourceRef="b" targetRef="u"/><sequenceFlow id="g" sourceRef="t" targetRef="x"/>
  <exclusiveGateway id="x" default="q"/><sequenceFlow id="q" sourceRef="x" targetRef="e"/><endEvent id="e"/>
  <sequenceFlow id="r" sourceRef="x" targetRef="c"><conditionExpression>n &lt; levels</conditionExpression>
  </sequenceFlow>
  <callActivity id="c" calledElement="P"/><sequenceFlow id="k" sourceRef="c" targetRef="e"/>{more}</process>
  <process id="M" isExecutable="true"><startEvent id="ms"/><sequenceFlow id="mf" sourceRef="ms" targetRef="mc"/>
  <callActivity id="mc" calledElement="P"/><sequenceFlow id="mg" sourceRef="mc" targetRef="mw"/><userTask id="mw"/>
  <sequenceFlow id="mh" sourceRef="mw" targetRef="me"/><endEvent id="me"><compensateEventDefinition/></endEvent>
  </process>"""
"""A process that calls itself `levels` deep; then its tasks are compensated."""
HANDLER = """<subProcess id="h" triggeredByEvent="true"><startEvent id="hs"><compensateEventDefinition/></startEvent>
  <scriptTask id="hu"><script>undone = undone + 1</script></scriptTask>
  <sequenceFlow id="hf" sourceRef="hs" targetRef="hu"/></subProcess>"""


@pytest.mark.parametrize(("levels", "more"), [(900, ""), (90, HANDLER)], ids=["tasks", "handlers"])
def test_what_can_be_compensated_at_any_depth_can_be_stored(levels: int, more: str, tmp_path: Path) -> None:
    definitions = read_bytes(document(AGAIN.format(more=more)).encode(), file="again.bpmn")
    simulation = fame.Simulation(definitions, process="M", variables={"n": 0, "undone": 0, "levels": levels})
    simulation.run()
    simulation.save(tmp_path / "state")
    loaded = fame.Simulation.load(tmp_path / "state", definitions)
    loaded.complete("mw")
    loaded.run()
    assert (loaded.instances[0].status, loaded.instances[0].variables["n"]) == ("completed", levels)
    assert loaded.instances[0].variables["undone"] == (1 if more else levels)


def test_handlers_inside_more_others_than_can_be_stored_are_an_error() -> None:
    definitions = read_bytes(document(AGAIN.format(more=HANDLER)).encode(), file="again.bpmn")
    simulation = fame.Simulation(definitions, process="M", variables={"n": 0, "undone": 0, "levels": 900})
    simulation.run()
    assert "compensation handlers of more than 100 completed activities inside" in str(simulation.instances[0].error)


# ---- files without pools ---------------------------------------------------------------------------------------------

ALONE = '<startEvent id="{0}s"/><scriptTask id="{0}t"><script>log("{0}")</script></scriptTask>' + (
    '<sequenceFlow id="{0}f" sourceRef="{0}s" targetRef="{0}t"/>'
)
CALLS = '<startEvent id="As"/><callActivity id="At" calledElement="B"/>' + (
    '<sequenceFlow id="Af" sourceRef="As" targetRef="At"/>'
)


@pytest.mark.parametrize(
    ("first", "second", "runs"),
    [
        ((ALONE, "true"), (ALONE, "true"), ""),
        ((ALONE, "true"), (ALONE, "false"), "A"),
        ((CALLS, "true"), (ALONE, "true"), "A"),
    ],
    ids=["two", "one is executable", "one is called"],
)
def test_what_a_check_says_of_processes_without_pools_is_what_a_run_does(
    first: tuple[str, str], second: tuple[str, str], runs: str, tmp_path: Path
) -> None:
    bodies = (f'<process id="{id}" isExecutable="{is_executable}">{body.format(id)}</process>'
              for id, (body, is_executable) in zip("AB", (first, second), strict=True))  # fmt: skip
    (tmp_path / "m.bpmn").write_text(document("".join(bodies)))
    found = [one.text for one in check(tmp_path / "m.bpmn") if one.level == "error"]
    if runs:
        assert found == []
        assert [robot.name for robot in Scenario.load(tmp_path / "m.bpmn").run().robots] == [runs]
    else:
        assert found[0].startswith("nothing to run: it has 2 processes and no pool for them: expected one with isExec")
        with pytest.raises(ModelError, match="nothing to run"):
            Scenario.load(tmp_path / "m.bpmn").run()


def test_the_part_of_a_file_without_pools_that_calls_its_neighbour_runs(tmp_path: Path) -> None:
    (tmp_path / "main.bpmn").write_text(document(f'<process id="A" isExecutable="true">{CALLS}</process>'))
    (tmp_path / "b.bpmn").write_text(document(f'<process id="B" isExecutable="true">{ALONE.format("B")}</process>'))
    (part,) = split(tmp_path / "main.bpmn")
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "A.bpmn").write_bytes(part.source)
    result = Scenario.load(tmp_path / "alone" / "A.bpmn").run()
    assert [event.detail for event in result.reports] == ["B"]
