"""A YAML file that another command is for is refused with the name of that command."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fame.cli import main

FILES = {
    "scenario": ({"model": "m.bpmn", "seed": 1}, "is a scenario, which is for fame run"),
    "world": ({"size": [4, 4], "robots": []}, "is a world, which is for fame world"),
    "node": ({"Inputs": {}, "Training": {}}, "is the configuration of a node, which is for fame process, "),
    "learning": ({"Files": {}, "Split": {}}, "is a learning file, which is for fame adm learn"),
}
COMMANDS = {
    "run": (["run"], ("scenario",)),
    "world": (["world"], ("world", "scenario")),
    "process": (["process"], ("node",)),
    "train": (["train"], ("node",)),
    "record": (["record", "-o", "x.csv"], ("node",)),
    "learn": (["adm", "learn", "-o", "x.skops"], ("learning",)),
}


@pytest.mark.parametrize(
    ("command", "kind"), [(name, kind) for name, (_, own) in COMMANDS.items() for kind in FILES if kind not in own]
)
def test_a_file_for_another_command_is_refused_with_its_name(command: str, kind: str, tmp_path: Path, capsys) -> None:
    content, said = FILES[kind]
    path = tmp_path / "file.yaml"
    path.write_text(yaml.safe_dump(content))
    (first, *rest), _ = COMMANDS[command]
    words = [first, *rest[:1], str(path), *rest[1:]] if first == "adm" else [first, str(path), *rest]
    assert main(words) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"fame: error: {path}: {said}")
    assert err.count("\n") == 1


def test_a_file_with_keys_that_none_has_is_told_those_that_are_known(tmp_path: Path, capsys) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("speed: 3\n")
    assert main(["train", str(path)]) == 2
    assert "found the key 'speed'; known are Inputs, Outputs" in capsys.readouterr().err
