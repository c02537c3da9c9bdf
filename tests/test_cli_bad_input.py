"""What is wrong with a file or a mission is said in one clear line, with the exit code that fits, and no traceback."""

import json
import os
from pathlib import Path
from typing import NamedTuple

import pytest
from bpmn_text import document, process, properties

from fame.cli import main

START, END = '<startEvent id="s"/>', '<endEvent id="e"/>'


def flow(source: str, target: str) -> str:
    return f'<sequenceFlow id="{source}_{target}" sourceRef="{source}" targetRef="{target}"/>'


def task(content: str, tag: str = "scriptTask", attributes: str = "") -> str:
    """A process of one activity between start and end."""
    activity = f'<{tag} id="t" {attributes}>{content}</{tag}>'
    return process(f"{START}{activity}{END}{flow('s', 't')}{flow('t', 'e')}")


def script(text: str) -> str:
    return task(f"<script>{text}</script>")


def throw(payload: str) -> str:
    event = f'<intermediateThrowEvent id="t">{properties(type="std_msgs/msg/Bool", payload=payload)}'
    event += '<signalEventDefinition signalRef="S"/></intermediateThrowEvent>'
    return process(f"{START}{event}{END}{flow('s', 't')}{flow('t', 'e')}", root='<signal id="S" name="done"/>')


class Bad(NamedTuple):
    """A bad file: its text, the exit code, and what has to be said of it."""

    text: str
    code: int
    said: tuple[str, ...]


MODELS = {
    "not XML": Bad("robots, please go", 2, ("mission.bpmn:1", "XML")),
    "empty": Bad("", 2, ("mission.bpmn", "XML")),
    "truncated": Bad(script("x = 1")[:-60], 2, ("mission.bpmn", "XML")),
    "a DTD": Bad("<!DOCTYPE d [<!ENTITY x 'y'>]>" + script("x = 1"), 2, ("mission.bpmn", "document type")),
    "another namespace": Bad('<definitions xmlns="http://example.org/other"/>', 2, ("mission.bpmn:1", "namespace")),
    "a flow to nowhere": Bad(process(f"{START}{flow('s', 'gone')}"), 2, ("mission.bpmn:3", "s_gone", "gone")),
    "a boundary event on nothing": Bad(
        process(f'{START}<boundaryEvent id="b" attachedToRef="gone"><errorEventDefinition/></boundaryEvent>'),
        2,
        ("mission.bpmn:3", "b", "gone"),
    ),
    "a process that calls itself": Bad(task("", "callActivity", 'calledElement="P"'), 2, ("t", "endlessly")),
    "a called process that is not there": Bad(
        task("", "callActivity", 'calledElement="Fly"'), 2, ("mission.bpmn:3", "t", "Fly", "library")
    ),
    "a syntax error": Bad(script("x = 1\ny = = 2"), 2, ("mission.bpmn:4", "t", "syntax")),
    "an unknown language": Bad(
        task("<script>1</script>", attributes='scriptFormat="cobol"'), 2, ("mission.bpmn:3", "t", "cobol", "python")
    ),
    "a payload that does not fit": Bad(throw("{x: 1}"), 2, ("mission.bpmn:3", "t", "std_msgs/msg/Bool")),
    "an unknown message type": Bad(throw("1").replace("/Bool", "/Bolo"), 2, ("std_msgs/msg/Bolo",)),
    "a script that raises": Bad(script("x = 1\nx / 0"), 1, ("P: t", "mission.bpmn:4", "ZeroDivisionError")),
    "an error nobody catches": Bad(script("raise BpmnError('blade_blocked')"), 1, ("P", "t", "blade_blocked")),
    "a script without an end": Bad(script("while True: pass"), 1, ("P", "t", "budget")),
    "a loop that never waits": Bad(
        process(f'{START}<exclusiveGateway id="g"/><task id="t"/>{flow("s", "g")}{flow("g", "t")}{flow("t", "g")}'),
        1,
        ("P: ", "without waiting", "loop over"),
    ),
    "nothing to run": Bad(
        document('<collaboration id="C"><participant id="X" name="REX"/></collaboration>'), 2, ("black boxes", "REX")
    ),
    "two pools of one name": Bad(
        document(
            '<collaboration id="C"><participant id="X" name="REX" processRef="P"/>'
            '<participant id="Y" name="Rex" processRef="Q"/></collaboration>'
            f'<process id="P">{START}</process><process id="Q">{START}</process>'.replace('"s"', '"s1"', 1)
        ),
        2,
        ("Y", "two pools"),
    ),
}
SLOW = ("a script without an end", "a loop that never waits")


def one_line(capsys: pytest.CaptureFixture[str], code: int, *said: str) -> str:
    """The one line on stderr, which says all of this."""
    err = capsys.readouterr().err
    lines = err.splitlines()
    assert lines, "nothing was said"
    assert lines[0].startswith("fame: ")
    assert "Traceback" not in err
    assert "bug" not in err
    assert code == 1 or len(lines) == 1
    for text in said:
        assert text.lower() in lines[0].lower()
    return lines[0]


@pytest.mark.parametrize("bad", MODELS.values(), ids=MODELS)
def test_a_bad_model_is_refused_or_fails_in_one_line(bad: Bad, tmp_path: Path, capsys) -> None:
    (tmp_path / "mission.bpmn").write_text(bad.text)
    assert main(["run", str(tmp_path / "mission.bpmn"), "--quiet"]) == bad.code
    one_line(capsys, bad.code, *bad.said)


@pytest.mark.parametrize("name", [name for name in MODELS if name not in SLOW])
def test_with_json_it_is_one_object(name: str, tmp_path: Path, capsys) -> None:
    bad = MODELS[name]
    (tmp_path / "mission.bpmn").write_text(bad.text)
    assert main(["run", str(tmp_path / "mission.bpmn"), "--json"]) == bad.code
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert err == ""
    assert told["status"] == ("failed" if bad.code == 1 else "error")
    lines = told["messages"] if bad.code == 1 else [told["error"]["text"]]
    assert all(text.lower() in lines[0].lower() for text in bad.said)


def test_a_huge_file_is_refused_without_being_read(tmp_path: Path, capsys) -> None:
    path = tmp_path / "huge.bpmn"
    with path.open("wb") as stream:
        stream.truncate(200_000_000)
    assert main(["run", str(path)]) == 2
    one_line(capsys, 2, "huge.bpmn", "MB")


def test_a_topic_that_nobody_publishes_ends_the_run_at_its_duration(tmp_path: Path, capsys) -> None:
    (tmp_path / "mission.bpmn").write_text(script('await receive("battery", "std_msgs/msg/Bool")\n'))
    (tmp_path / "s.yaml").write_text(
        "model: mission.bpmn\nduration: 3\nworld: {size: [2, 2], robots: {P: {type: car, at: [1, 1]}}}\n"
    )
    assert main(["run", str(tmp_path / "s.yaml"), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["status"], told["simulated"]) == ("timeout", 3.0)
    assert "P waits at t for receive on topic /P/battery, which no other node publishes" in told["messages"]


WORLD = "{{size: [4, 4], obstacles: [{{name: rock, at: [3, 3], radius: 0.5}}], robots: {{{robots}}}}}"
SCENARIOS = {
    "no YAML": ("model: [", ("s.yaml:1",)),
    "an empty file": ("", ("s.yaml", "empty")),
    "not a mapping": ("- model", ("s.yaml",)),
    "no model": ("seed: 1", ("s.yaml", "model")),
    "a model that is not there": ("model: gone.bpmn", ("gone.bpmn",)),
    "an unknown key": ("model: mission.bpmn\nsed: 3", ("s.yaml:2", "sed", "seed")),
    "a wrong value": ("model: mission.bpmn\nseed: early", ("s.yaml:2", "seed", "early")),
    "a robot that no pool knows": (
        "model: mission.bpmn\nworld: " + WORLD.format(robots="P: {type: car, at: [1, 1]}, Q: {type: car, at: [2, 2]}"),
        ("s.yaml", "'Q'", "P"),
    ),
    "a pool without a robot": ("model: mission.bpmn\nworld: " + WORLD.format(robots=""), ("s.yaml", "'P'")),
    "a robot inside an obstacle": (
        "model: mission.bpmn\nworld: " + WORLD.format(robots="P: {type: car, at: [3, 3.1]}"),
        ("s.yaml:2", "P", "rock"),
    ),
    "a robot of an unknown type": (
        "model: mission.bpmn\nworld: " + WORLD.format(robots="P: {type: submarine, at: [1, 1]}"),
        ("s.yaml:2", "P", "submarine", "car"),
    ),
}


@pytest.mark.parametrize(("text", "said"), SCENARIOS.values(), ids=SCENARIOS)
def test_a_bad_scenario_is_refused_in_one_line(text: str, said: tuple[str, ...], tmp_path: Path, capsys) -> None:
    (tmp_path / "mission.bpmn").write_text(script("x = 1"))
    (tmp_path / "s.yaml").write_text(text)
    assert main(["run", str(tmp_path / "s.yaml")]) == 2
    one_line(capsys, 2, *said)


REQUESTS = {
    "an unknown command": (["fly"], ("fly", "run")),
    "an unknown option": (["run", "x.bpmn", "--fast"], ("--fast",)),
    "no file": (["run"], ("scenario",)),
    "a file that is not there": (["run", "gone.bpmn"], ("gone.bpmn", "no such file")),
    "a scenario that is not there": (["run", "gone.yaml"], ("gone.yaml", "no such file")),
    "a folder": (["run", "."], (".yaml", ".bpmn")),
    "a file of another kind": (["run", "mission.txt"], ("mission.txt", ".yaml", ".bpmn")),
    "a wrong seed": (["run", "mission.bpmn", "--seed", "-1"], ("--seed", "-1")),
    "a wrong duration": (["run", "mission.bpmn", "--duration", "nan"], ("--duration", "nan", "above 0")),
    "a log of unknown form": (["run", "mission.bpmn", "--log", "run.txt"], ("run.txt", ".jsonl", ".csv", ".xes")),
    "a log nobody can write": (["run", "mission.bpmn", "--log", "mission.bpmn/run.csv"], ("run.csv", "written")),
    "a picture without a world": (["run", "mission.bpmn", "--picture", "out.png"], ("out.png", "no world")),
    "a picture of unknown form": (["run", "mission.bpmn", "--picture", "out.tiff"], ("out.tiff", ".png")),
    "a film of unknown form": (["run", "mission.bpmn", "--animate", "out.avi"], ("out.avi", ".gif", ".mp4")),
    "nowhere to split to": (["split", "mission.bpmn"], ("--output",)),
    "splitting into a file": (
        ["split", "mission.bpmn", "-o", "mission.bpmn"],
        ("mission.bpmn", "expected a folder, got a file"),
    ),
    "a drawing of unknown form": (["draw", "mission.bpmn", "-o", "out.pdf"], ("out.pdf", ".svg")),
    "a layout of unknown form": (["layout", "mission.bpmn", "-o", "out.svg"], ("out.svg", ".bpmn")),
    "a library that is not there": (["run", "mission.bpmn", "--library", "gone"], ("gone", "not a folder")),
    "checking a folder": (["check", "."], (".: expected files", ".bpmn")),
    "checking what is not there": (["check", "mission.bpmn", "gone.bpmn"], ("gone.bpmn", "no such file")),
}


@pytest.mark.parametrize(("arguments", "said"), REQUESTS.values(), ids=REQUESTS)
def test_a_wrong_request_is_refused_in_one_line(
    arguments: list[str], said: tuple[str, ...], tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mission.bpmn").write_text(script("x = 1"))
    assert main(arguments) == 2
    assert one_line(capsys, 2, *said).startswith("fame: error: ")
    assert main([*arguments, "--json"]) == 2
    out, err = capsys.readouterr()
    assert err == ""
    assert all(text in json.loads(out)["error"]["text"].lower() for text in said)


@pytest.mark.parametrize("name", ["", "a b", "1st", "a/b", "~", "Ä"])
def test_the_name_of_an_engine_is_one_that_ros_allows(name, capsys):
    assert main(["engine", name]) == 2
    assert "a letter first" in capsys.readouterr().err


def test_an_endless_file_is_told_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "/dev/zero"]) != 0
    told = "".join(capsys.readouterr())
    assert "expected at most 20 MB" in told
    assert "bug in FAME" not in told


def test_what_a_robot_of_ones_own_raises_is_told_with_its_file_and_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "from robots import Car\n\n\nclass Boat(Car):\n    def sense(self, now, count):\n        self.depht += 1\n"
    (tmp_path / "boat.py").write_text(code)
    world = "world: {size: [5, 5], robots: {P: {type: 'boat.py:Boat', at: [1, 1]}}}"
    (tmp_path / "s.yaml").write_text(f"model: m.bpmn\n{world}\n")
    (tmp_path / "m.bpmn").write_text(process('<startEvent id="s"/><userTask id="u"/>'))
    assert main(["run", str(tmp_path / "s.yaml")]) == 2
    told = capsys.readouterr().err
    assert told.startswith(
        f"fame: error: {tmp_path / 'boat.py'}:6: AttributeError: 'Boat' object has no attribute 'depht'"
    )


@pytest.mark.parametrize("name", ["m.bpmn", "m.yaml", "m.mcap", "m.jsonl"])
def test_a_pipe_with_a_name_is_no_file(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / name)
    command = ["log", "convert", "-o", str(tmp_path / "out.csv")] if name.endswith(("mcap", "jsonl")) else ["run"]
    assert main([*command, str(tmp_path / name)]) == 2
    assert capsys.readouterr().err.endswith(f"{name}: cannot be read: expected a file, got a named pipe\n")


def test_a_name_cannot_control_a_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pools = '<collaboration id="c"><participant id="A" name="A\x9b31mB" processRef="P"/></collaboration>'
    (tmp_path / "m.bpmn").write_text(process(START, root=pools))
    assert main(["check", str(tmp_path / "m.bpmn")]) == 0
    told = "".join(capsys.readouterr())
    assert '"A\\x9b31mB" (A)' in told
    assert "\x9b" not in told
