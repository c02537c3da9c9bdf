"""Files that people write: an error names file, line, key path, what was expected and what was found."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from fame.bpmn.model import Expression
from fame.cli import main
from fame.cli.arguments import assignment
from fame.cli.scenarios import _change
from fame.config.loader import parse_document
from fame.errors import ConfigError, ValueChanged
from fame.scripting import compile_expression

FILES = {
    "scenario": ({"model": "m.bpmn", "seed": 1}, "is a scenario, which is for fame run"),
    "world": ({"size": [4, 4], "robots": []}, "is a world, which is for fame world"),
    "node": ({"Inputs": {}, "Training": {}}, "is the configuration of a node, which is for fame monitor process, "),
    "learning": ({"Files": {}, "Split": {}}, "is a learning file, which is for fame monitor adm learn"),
    "project": ({"scenarios": [], "tests": []}, "is a project, which is for fame run without a file"),
}
COMMANDS = {
    "run": (["run"], ("scenario",)),
    "world": (["world"], ("world", "scenario")),
    "process": (["monitor", "process"], ("node",)),
    "train": (["monitor", "train"], ("node",)),
    "record": (["monitor", "record", "-o", "x.csv"], ("node",)),
    "learn": (["monitor", "adm", "learn", "-o", "x.skops"], ("learning",)),
}


@pytest.mark.parametrize(
    ("command", "kind"), [(name, kind) for name, (_, own) in COMMANDS.items() for kind in FILES if kind not in own]
)
def test_a_file_for_another_command_is_refused_with_its_name(command: str, kind: str, tmp_path: Path, capsys) -> None:
    content, said = FILES[kind]
    path = tmp_path / "file.yaml"
    path.write_text(yaml.safe_dump(content))
    words, _ = COMMANDS[command]
    options = words.index("-o") if "-o" in words else len(words)
    assert main([*words[:options], str(path), *words[options:]]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"fame: error: {path}: {said}")
    assert err.count("\n") == 1


def test_a_file_with_keys_that_none_has_is_told_those_that_are_known(tmp_path: Path, capsys) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("speed: 3\n")
    assert main(["monitor", "train", str(path)]) == 2
    assert "file.yaml:1: speed: unknown key; known are: Inputs, Outputs" in capsys.readouterr().err


WRONG = {
    "scenario": (
        "run",
        "model: m.bpmn\nworld:\n  size: [4, 4]\n  robots:\n    REX: {type: car, at: [1, x]}\n",
        ":5: world.robots.REX.at[1]: expected a number, got 'x'",
    ),
    "world": ("world", "size: [4, 4]\nstep: fast\n", ":2: step: expected a number from 0.0001 to 0.05, got 'fast'"),
    "pipeline": (
        "monitor process",
        "Inputs:\n  A: {Topic: t, MessageType: std_msgs/msg/Float64, Field: data}\nFrequency: fast\n",
        ":3: Freq",
    ),
    "learning": (
        "monitor adm learn -o x.skops",
        "Files:\n  unsupervised_train: {name: a.csv, input_col: [0]}\nSplit:\n  folds: 1\n",
        ":4: Split.folds: ",
    ),
}


@pytest.mark.parametrize("kind", WRONG)
def test_every_kind_of_file_is_refused_with_file_line_and_key_path(kind: str, tmp_path: Path, capsys) -> None:
    command, text, said = WRONG[kind]
    path = tmp_path / "file.yaml"
    path.write_text(text)
    assert main([*command.split(), str(path)]) == 2
    assert f"fame: error: {path}{said}" in capsys.readouterr().err


def test_a_value_that_an_alias_repeats_and_one_that_is_merged_in_have_the_line_of_the_key_around_them() -> None:
    text = "a: &a\n  x: 1\nb: *a\nc:\n  <<: *a\n  y: 2\n"
    values = parse_document(text, "f.yaml").mapping()
    assert [values[name].mapping()["x"].line for name in "abc"] == [2, 3, 4]
    with pytest.raises(ConfigError, match=r"^f.yaml:3: b.x: expected a text, got 1$"):
        values["b"].mapping()["x"].text()


def test_keys_with_dots_are_not_taken_for_paths_given_twice() -> None:
    assert parse_document("a: {b: 1}\na.b: 2\n").data == {"a": {"b": 1}, "a.b": 2}
    with pytest.raises(ConfigError, match=r"^line 2: a: is given twice$"):
        parse_document("a: 1\na: 2\n")


SCALARS = {  # what earlier releases, and PyYAML, read in another way
    "1e-3": 0.001,
    "NO": "NO",
    "on": "on",
    "12:30": "12:30",
    "010": 10,
    "0o10": 8,
    "1_000": "1_000",
    "2024-01-01": "2024-01-01",
    "0b1": "0b1",
}


@pytest.mark.parametrize(("text", "value"), SCALARS.items())
def test_a_scalar_means_the_same_in_a_file_an_option_a_payload_and_a_data_object(text: str, value: Any) -> None:
    with pytest.warns(ValueChanged, match=re.escape(f"`{text}` is now ")):
        assert parse_document(f"{{a: [{text}]}}").data == {"a": [value]}
    with pytest.warns(ValueChanged):
        assert assignment(f"a={text}") == ("a", value)
    with pytest.warns(ValueChanged):
        assert _change(f"a={text}") == ("a", value)
    assert compile_expression(Expression(f"{{a: [{text}]}}", "payload"))({}) == {"a": [value]}
    assert compile_expression(Expression(text, "value"))({}) == value


def test_what_earlier_releases_read_in_another_way_is_noted_once_with_its_place(tmp_path: Path, capsys) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("model: m.bpmn\nduration: 1e2\nepoch: 2026-11-28\nvariables: {mode: on, far: 5, other: 'on'}\n")
    assert main(["check", str(path)]) == 1  # there is no such model
    assert capsys.readouterr().err.splitlines()[:2] == [
        f"fame: note: {path}:2: duration: `1e2` is now 100.0; earlier releases read the text '1e2'",
        f"fame: note: {path}:4: variables.mode: `on` is now the text 'on'; earlier releases read true",
    ]
