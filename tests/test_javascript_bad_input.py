"""What is wrong with a script is an error of that script: events of the model catch it, else its robot alone fails."""

import subprocess
import sys
from pathlib import Path

import pytest
from javascript_models import ROOT, chain, flows, task

import fame
from fame.scenario import Scenario
from fame.scripting.javascript import source

NODE = "const node = this.environment.variables.ros_node;\n"
WRONG = {
    "an error that is thrown": ("let x = 1;\nthrow new Error('oh');", 1, "Error: oh"),
    "an error given to next": ("\nnext(new Error('oh'));", 1, "Error: oh"),
    "a name that is not there": ("next();\nnobody.knows();", 1, "nobody is not defined"),
    "next twice": ("next();\nnext();", 1, "next() was called twice"),
    "next never": ("const x = 1;", 0, "never calls next()"),
    "an endless loop": ("\nfor (;;) {}", 1, "one step of the script took more than 0.1 s"),
    "a memory bomb": ("const held = [];\nfor (;;) held.push('x'.repeat(1e5) + held.length);", 1, "8 MB"),
    "endless recursion": ("const f = () => f();\nf();", 0, "call stack"),
    "a field that the type has not": (
        f"{NODE}node.createPublisher('std_msgs/msg/Bool', 'led').publish({{ on: true }});\nnext();", 1,
        "on: there is no such field",
    ),
    "a value that does not fit": (
        f"{NODE}node.createPublisher('std_msgs/msg/Bool', 'led').publish({{ data: 'maybe' }});\nnext();", 1, "data: ",
    ),
    # Composed: what a script says literally is known to be wrong before it runs.
    "a publisher of an unknown type": (
        f"{NODE}node.createPublisher('std_msgs/msg/' + 'Boole', 'led');\nnext();", 1, "there is no such message type",
    ),
    "a subscription to an unknown type": (
        f"{NODE}node.createSubscription('std_msgs/msg/' + 'Boole', 'led', () => {{}});\nnext();", 1,
        "there is no such message type",
    ),
    "a client of an unknown type": (
        f"{NODE}node.createClient('std_srvs/srv/Trig', 'go');\nnext();", 1, "there is no such service type",
    ),
    "a service that nobody offers": (
        f"{NODE}const go = node.createClient('std_srvs/srv/SetBool', 'go');\ngo.sendRequest({{ data: true }}, next);",
        2, "no node offers the service /REX/go",
    ),
    "a way to the host": (
        "const F = this.constructor.constructor;\nF('return process')();\nnext();", 1, "process is not defined",
    ),
    "a prototype of all": (
        "\nObject.prototype.toString.call.constructor('return require')()('fs');", 1, "require is not defined",
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "SECONDS", 0.1)
    monkeypatch.setattr(source, "MEMORY", 8 * 2**20)


def model(text: str, guard: str = "") -> str:
    """A collaboration: REX runs the script from line 5 on, DINGO waits a second and goes home."""
    pools = "".join(f'<participant id="Pool_{name}" name="{name}" processRef="{name}"/>' for name in ("REX", "DINGO"))
    waits = "<timerEventDefinition><timeDuration>PT1S</timeDuration></timerEventDefinition>"
    return (
        f'{ROOT}<collaboration id="C">{pools}</collaboration>\n<process id="REX">\n{task("t", text)}'
        f'<startEvent id="s"/><endEvent id="e"/>{flows("s", "t", "e")}{guard}</process><process id="DINGO">'
        f'<startEvent id="ds"/><intermediateCatchEvent id="dw">{waits}</intermediateCatchEvent><endEvent id="de"/>'
        f"{flows('ds', 'dw', 'de')}</process></definitions>"
    )


@pytest.mark.parametrize(("text", "line", "complaint"), WRONG.values(), ids=WRONG.keys())
def test_its_robot_alone_fails_with_file_element_and_line(text: str, line: int, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(model(text))
    result = Scenario.load(path).run()
    assert {robot.name: (robot.completed, robot.failed) for robot in result.robots} == {"REX": (0, 1), "DINGO": (1, 0)}
    (error,) = (error for robot in result.robots for error in robot.errors)
    assert isinstance(error, fame.MissionError)
    assert (error.robot, error.element, error.file, error.line) == ("REX", "t", str(path), 5 + line)
    assert complaint in error.text
    assert "\n" not in str(error)


HANDLER = f"""<subProcess id="h" triggeredByEvent="true"><startEvent id="hs"><errorEventDefinition/></startEvent>
<endEvent id="caught"/>{flows("hs", "caught")}</subProcess>"""
BOUNDARY = (
    '<boundaryEvent id="b" attachedToRef="t"><errorEventDefinition/></boundaryEvent><endEvent id="caught"/>'
    + flows("b", "caught")
)


@pytest.mark.parametrize("guard", [HANDLER, BOUNDARY], ids=["event sub-process", "boundary event"])
@pytest.mark.parametrize("text", [text for text, _, _ in WRONG.values()], ids=WRONG.keys())
def test_events_of_the_model_catch_it(text: str, guard: str, tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(model(text, guard))
    caught: list[str] = []
    result = Scenario.load(path).run(observer=lambda event: caught.append(event.element))
    assert {robot.name: (robot.completed, robot.failed) for robot in result.robots} == {"REX": (1, 0), "DINGO": (1, 0)}
    assert "caught" in caught


@pytest.mark.parametrize(
    ("text", "line", "complaint"),
    [("let x = ;\nnext();", 0, "unexpected token"), ("next();\nfor (", 1, "unexpected"), ("}\nnext(); {", 1, "")],
)
def test_a_syntax_error_is_told_before_anything_moves(text: str, line: int, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_text(model(text, BOUNDARY))
    with pytest.raises(fame.ModelError, match="not valid JavaScript") as caught:
        Scenario.load(path).run()
    assert (caught.value.file, caught.value.element, caught.value.line) == (str(path), "t", 5 + line)
    assert complaint in caught.value.text


def test_a_command_ends_in_silence_though_the_engine_of_javascript_has_a_thread(tmp_path: Path) -> None:
    path = tmp_path / "m.bpmn"
    path.write_bytes(chain("next();").source)
    done = subprocess.run([sys.executable, "-m", "fame", "run", str(path)], capture_output=True, text=True, check=True)
    assert done.stderr == ""
