"""Each wrong property of a file is one line with file, line and column, by every command that judges properties."""

from pathlib import Path

import pytest
from bpmn_text import document, properties
from test_properties import WRONG

from fame.cli import main

UNSEEN = {"always A.speed > 1", "A throws /found where name > 1"}
"""Wrong in variables and fields, which a log of events does not have."""


def team() -> str:
    """The robots of `compare_properties.VOCABULARY`: each has X, catches /found at Y, and throws /found and /done."""

    def signal(id: str, name: str) -> str:
        type = properties(type="std_msgs/msg/Int32") if name else ""
        return type + (f'<signalEventDefinition id="S_{id}" signalRef="{name}"/>' if name else "")

    processes, pools = "", ""
    for robot in "ABT":
        nodes = [("startEvent", "X", ""), ("intermediateCatchEvent", "Y", "found"),
                 ("intermediateThrowEvent", "found", "found"), ("intermediateThrowEvent", "done", "done")]  # fmt: skip
        inner = "".join(
            f'<{tag} id="{robot}{at}" name="{label}">{signal(f"{robot}{at}", name)}</{tag}>'
            for at, (tag, label, name) in enumerate(nodes)
        )
        inner += "".join(
            f'<sequenceFlow id="F{robot}{at}" sourceRef="{robot}{at}" targetRef="{robot}{at + 1}"/>' for at in range(3)
        )
        data = f'<dataObjectReference id="R{robot}" dataObjectRef="O{robot}">{properties(v="1", w="2")}'
        inner += f'{data}</dataObjectReference><dataObject id="O{robot}"/>'
        processes += f'<process id="P{robot}" isExecutable="true">{inner}</process>'
        several = '<participantMultiplicity id="M" minimum="2"/>' if robot == "T" else ""
        pools += f'<participant id="Pool_{robot}" name="{robot}" processRef="P{robot}">{several}</participant>'
    signals = '<signal id="found" name="found"/><signal id="done" name="done"/>'
    return document(f'{signals}<collaboration id="C">{pools}</collaboration>{processes}')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the model, and a log of a run."""
    found = tmp_path_factory.mktemp("wrong")
    (found / "team.bpmn").write_text(team())
    main(["run", str(found / "team.bpmn"), "--duration", "1", "--log", str(found / "run.jsonl")])
    return found


@pytest.mark.parametrize("sentence", WRONG)
def test_a_wrong_property_is_one_line_with_its_place(
    sentence: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    column, text = WRONG[sentence]
    model, log, file = folder / "team.bpmn", folder / "run.jsonl", folder / "team.properties.yaml"
    quoted = sentence.replace("'", "''")
    file.write_text(f"properties:\n  p: '{quoted}'\n")
    commands = {("run", str(model)): 2, ("check", str(model)): 1, ("log", "judge", str(file), str(log)): 2}
    if sentence in UNSEEN:
        del commands["log", "judge", str(file), str(log)]
    for command, code in commands.items():
        assert main(list(command)) == code
        captured = capsys.readouterr()
        (line,) = [one for one in (captured.out + captured.err).splitlines() if str(file) in one]
        place = f"{file}:2:{6 + column}: " if sentence else f"{file}:2: "
        assert place in line
        assert "properties.p: " in line
        assert sentence in UNSEEN or not sentence or text in line
