"""Configurations as published, and with what was added; what is wrong with one is said before anything runs."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from fame.config.values import ConfigValue
from fame.errors import ConfigError, FameError, MessageError
from fame.middleware import messages
from fame.middleware.interface import SIGNAL
from fame.monitor.pipeline.configuration import INPUT, Configuration, load
from fame.monitor.pipeline.fields import UnusableMessage, reader, writer
from fame.monitor.pipeline.processors import assign, find_class, make_processors
from fame.monitor.pipeline.training_settings import training_of
from fame.rooms import PROCESSORS

PUBLISHED = """\
Inputs:
  Effort0:
    Description: "Effort0"
    Topic: "effort_split_lp"
    Field: ["effort0"]
    MessageType: "SplitEfforts"
Outputs:
  Loss:
    Description: "Encoder Loss"
    Topic: "encoder_loss_0"
    Field: ["loss"]
    MessageType: "EncoderLoss"
Imports:
  SplitEfforts: {Package: "ros_m1_messages.msg", Module: "SplitEfforts"}
  EncoderLoss: {Package: "ros_m1_messages.msg", Module: "EncoderLoss"}
"""
JOINTS = {"Topic": "joint_states", "Field": ["effort"], "MessageType": "sensor_msgs/msg/JointState"}
FLOAT = {"Topic": "out", "Field": ["data"], "MessageType": "std_msgs/msg/Float64"}


def read(folder: Path, **sections: object) -> Configuration:
    path = folder / "unit.yaml"
    path.write_text(yaml.safe_dump({"Inputs": {"Efforts": JOINTS}, "Outputs": {"Loss": FLOAT}, **sections}))
    return load(path)


def prepare(folder: Path, **sections: object) -> None:
    configuration = read(folder, **sections)
    assign(make_processors(configuration), configuration)


def refusal(folder: Path, **sections: object) -> str:
    """What is said against a configuration, when it is read or its processors are made."""
    with pytest.raises(FameError) as caught:
        prepare(folder, **sections)
    text = str(caught.value)
    assert "\n" not in text
    assert "unit.yaml" in text
    return text


def test_a_published_configuration_is_read_with_message_files_beside_it(tmp_path: Path) -> None:
    (tmp_path / "msg").mkdir()
    (tmp_path / "msg" / "SplitEfforts.msg").write_text("".join(f"float64 effort{n}\n" for n in range(6)))
    (tmp_path / "EncoderLoss.msg").write_text("float64 loss\n")
    (tmp_path / "encoder_0.yaml").write_text(PUBLISHED)
    found = load(tmp_path / "encoder_0.yaml")
    (given,), (told,) = found.inputs, found.outputs
    assert (given.name, given.topic, given.type) == ("Effort0", "effort_split_lp", "ros_m1_messages/msg/SplitEfforts")
    assert (told.path, told.description, found.stages) == (("loss",), "Encoder Loss", ())
    assert (found.name, found.frequency, given.qos, told.qos) == ("encoder_0", 50.0, INPUT, SIGNAL)
    with pytest.raises(ConfigError, match="expected a processor, got none"):
        make_processors(found)


def test_what_was_added_is_read(tmp_path: Path) -> None:
    found = read(
        tmp_path,
        Inputs={"Efforts": {**JOINTS, "Rate": 500, "QoS": {"depth": 7}}},
        Imports={"Loss": {"File": "Loss.msg", "Package": "mine"}} if (tmp_path / "Loss.msg").exists() else {},
        Processor=[{"Class": "LowPass", "Parameters": {"cutoff": 20}}, "RMS"],
        Frequency=100,
        QoS={"reliability": "reliable"},
        Name="monitor",
    )
    assert [stage.cls for stage in found.stages] == ["LowPass", "RMS"]
    assert (found.frequency, found.name, found.inputs[0].rate) == (100.0, "monitor", 500.0)
    assert (found.inputs[0].qos.reliability, found.inputs[0].qos.depth) == ("reliable", 7)
    low_pass, rms = make_processors(found)
    assert (low_pass.cutoff, rms.size) == (20.0, 50)


def test_a_message_file_is_imported_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "Grip.msg").write_text("float32 force\n")
    port = {"Topic": "grip", "Field": ["force"], "MessageType": "Grip"}
    found = read(tmp_path, Inputs={"Force": port}, Imports={"Grip": {"File": "Grip.msg", "Package": "hand_msgs"}})
    assert found.inputs[0].type == "hand_msgs/msg/Grip"


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ({"Inputs": {"X": {**JOINTS, "Field": ["efort"]}}}, "Inputs.X.Field: sensor_msgs/msg/JointState: there is no "
         "field efort; it has header, name, position, velocity, effort"),
        ({"Inputs": {"X": {**JOINTS, "Field": ["effort", -1]}}}, "expected an index from 0 on, got -1"),
        ({"Inputs": {"X": {**JOINTS, "Field": ["effort", 1, 2]}}}, "effort.1 is a number; nothing may follow"),
        ({"Inputs": {"X": {**JOINTS, "Field": ["name"]}}}, "name holds texts; expected numbers"),
        ({"Inputs": {"X": {**JOINTS, "Field": ["header"]}}}, "the path ends at a message; expected one of its fields"),
        ({"Inputs": {"X": {**JOINTS, "Field": []}}}, "the path ends at a message"),
        ({"Inputs": {"X": {**FLOAT, "Field": ["data", "x"]}}}, "data is a float64; nothing may follow, found x"),
        ({"Inputs": {"X": {**JOINTS, "MessageType": "JointStates"}}}, "X.MessageType: expected a message type or"),
        ({"Inputs": {"X": {"Topic": "a", "Field": ["data"]}}}, "Inputs.X: expected the key MessageType"),
        ({"Inputs": {"X": {**JOINTS, "Topic": "joint states"}}}, "expected the name of a topic, got 'joint states'"),
        ({"Inputs": {"X": {**JOINTS, "Rate": -3}}}, "Inputs.X.Rate: expected a number from 1e-06 to 1e+06, got -3"),
        ({"Inputs": {"X": {**JOINTS, "Feild": 1}}}, "Inputs.X.Feild: unknown key; did you mean 'Field'?"),
        ({"Inputs": {"X": JOINTS, "x": JOINTS}}, "X and x differ in capitals only"),
        ({"Inputs": {"X": JOINTS, "Y": {**FLOAT, "Topic": "joint_states"}}}, "expected one type"),
        ({"Inputs": {}, "Outputs": {}}, "expected the key Inputs or Outputs with at least one entry"),
        ({"Outputs": {"Y": {**FLOAT, "Field": ["value"]}}}, "Outputs.Y.Field: std_msgs/msg/Float64: there is no field"),
        ({"Outputs": {"Y": {**JOINTS, "Field": ["effort", 1]}}}, "outputs for the places 0, 1, ... once each, got [1]"),
        ({"Outputs": {"Y": FLOAT, "Z": FLOAT}}, "data: two outputs set this field"),
        ({"Outputs": {"Y": FLOAT}, "Processor": "Threshold"}, "needs a threshold, or a model with thresholds"),
        ({"Outputs": {"Y": FLOAT}, "Processor": {"Class": "Expression", "Parameters": {"formula": "Efforts"}},
          "Frequency": 0}, "Frequency: expected a number from 1e-06 to 1e+06, got 0"),
        ({"Outputs": {"Y": FLOAT, "Z": {**FLOAT, "Topic": "z"}}, "Processor": "LowPass"},
         "Outputs.Y: no processor computes it; LowPass computes Efforts"),
        ({"Processor": "LowPas"}, "got 'LowPas'; did you mean 'LowPass'?"),
        ({"Processor": "no_such_module:Class"}, "no_such_module cannot be imported: ModuleNotFoundError"),
        ({"Processor": "math:sqrt"}, "expected a class with a method execute(inputs), got math:sqrt"),
        ({"Processor": "user.py:Power"}, "there is no file"),
        ({"Processor": {"Class": "LowPass", "Parameters": {"cutof": 1}}}, "cutof: unknown parameter; known are"),
        ({"Processor": {"Class": "LowPass", "Parameters": {"cutoff": -1}}}, "Processor.Parameters.cutoff: expected "
         "a number of 1e-06 or more Hz, got -1.0"),
        ({"Processor": ["LowPass", {"Class": "Autoencoder", "Parameters": {"model": "none.skops"}}]},
         "none.skops: there is no such file"),
        ({"Processor": {"Parameters": {}}}, "Processor: expected the key Class"),
        ({"QoS": {"reliabilty": 1}}, "QoS: qos.reliabilty: there is no such policy"),
        ({"Imports": {"A": {"Package": "no_msgs.msg", "Module": "Nothing"}}}, "Imports.A: no_msgs/msg/Nothing: there "
         "is no such message type; the folder that has no_msgs is named in fame.yaml, here or above (types: [FOLDER]), "
         "or by --types; "
         "put a file Nothing.msg beside the configuration, or use the key File"),
        ({"Name": "a-b"}, "Name: expected a name of ASCII letters, digits and _, got 'a-b'"),
        ({"Filters": 1}, "Filters: unknown key; known are: Inputs, Outputs"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line_with_the_path_of_the_key(tmp_path: Path, sections, reason: str) -> None:
    assert reason in refusal(tmp_path, **sections)


@pytest.mark.parametrize(
    ("sections", "reason"),
    [
        ("Frequency: fast", "p.yaml:6: Frequency: expected a number from 1e-06 to 1e+06, got 'fast'"),
        ("Frequency: 5\nProcessor:\n  Class: LowPass\n  Parameters:\n    cutoff: low",
         "p.yaml:10: Processor.Parameters.cutoff: expected a number of 1e-06 or more Hz, got 'low'"),
        ("Processor: Spectrum\nTraining:\n  Held back: 2",
         "p.yaml:8: Training.Held back: expected a number above 0 and at most 1, got 2"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_told_with_its_line(tmp_path: Path, sections: str, reason: str) -> None:
    port = "    Topic: joint_states\n    Field: [effort]\n    MessageType: sensor_msgs/msg/JointState\n"
    (tmp_path / "p.yaml").write_text(f"Inputs:\n  Efforts:\n{port}{sections}")

    def use() -> None:
        configuration = load(tmp_path / "p.yaml")
        make_processors(configuration)
        training_of(configuration.training or ConfigValue({}), tmp_path)

    with pytest.raises(ConfigError, match=re.escape(reason)):
        use()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (": a\n b", "is not valid YAML"),
        ("- a", "expected a mapping"),
        ("", "expected a mapping"),
        (None, "cannot be read"),
    ],
)
def test_a_file_that_is_no_configuration_is_refused(tmp_path: Path, text: str | None, reason: str) -> None:
    if text is not None:
        (tmp_path / "unit.yaml").write_text(text)
    with pytest.raises(ConfigError, match=reason):
        load(tmp_path / "unit.yaml")


def test_a_processor_of_the_user_is_a_class_in_any_file(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "class Twice:\n    outputs = ('Loss',)\n    def execute(self, inputs):\n        return {'Loss': 2}\n"
        "class Broken:\n    def __init__(self): raise OSError('no device')\n    def execute(self, inputs): pass\n"
    )
    (made,) = make_processors(read(tmp_path, Processor="mine.py:Twice"))
    assert made.execute({}) == {"Loss": 2}
    assert find_class("fame.monitor.LowPass", tmp_path).__name__ == "LowPass"
    assert "mine.py:Broken cannot be made: OSError: no device" in refusal(tmp_path, Processor="mine.py:Broken")
    (tmp_path / "bad.py").write_text("def")
    assert "bad.py cannot be imported: SyntaxError" in refusal(tmp_path, Processor="bad.py:X")


def test_what_the_page_shows_is_true(tmp_path: Path) -> None:
    pages = Path(__file__).parent.parent / "docs"
    page = "".join((pages / name).read_text(encoding="utf-8") for name in ("pipelines.md", "training.md"))
    blocks = page.split("```")
    shown = next(block for block in blocks if block.startswith("yaml\nInputs"))
    (tmp_path / "msg").mkdir()
    (tmp_path / "msg" / "Grip.msg").write_text("float32 force\n")
    (tmp_path / "EncoderLoss.msg").write_text("float64 loss\n")
    (tmp_path / "page.yaml").write_text(shown.removeprefix("yaml\n"))
    found = load(tmp_path / "page.yaml")
    assert (found.name, found.inputs[0].rate, found.stages[0].cls) == ("low_pass", 500.0, "LowPass")
    training = next(block for block in blocks if block.startswith("yaml\nTraining")).removeprefix("yaml\n")
    section = {**yaml.safe_load(training)["Training"], "Files": []}
    asked = training_of(ConfigValue(section, "Training"), tmp_path)
    assert (asked.folds, asked.false_alarms) == (5, "0.01 per run")
    names = {name for line in page.splitlines() if line.startswith("| `") for name in re.findall(r"`(\w+)`", line)}
    assert names >= PROCESSORS.keys()


def test_a_model_is_looked_for_beside_the_configuration(tmp_path: Path) -> None:
    stage = {"Class": "Autoencoder", "Parameters": {"model": "sub/none.skops"}}
    assert f"{tmp_path}/sub/none.skops" in refusal(tmp_path, Processor=stage)


# ---- paths -----------------------------------------------------------------------------------------------------------


def joints(**fields: object):
    return messages.create("sensor_msgs/msg/JointState", {"name": ["elbow", "wrist"], "effort": [1.0, 2.0], **fields})


@pytest.mark.parametrize(
    ("path", "value", "names"),
    [
        (("effort",), [1.0, 2.0], ("elbow", "wrist")),
        (("effort", 1), 2.0, ()),
        (("effort", "wrist"), 2.0, ()),
        (("effort", ["wrist", "elbow"]), [2.0, 1.0], ("wrist", "elbow")),
        (("effort", [1, 0]), [2.0, 1.0], ("1", "0")),
        (("header", "stamp"), 3.5, ()),
        (("header", "stamp", "sec"), 3.0, ()),
    ],
)
def test_a_path_reads_numbers_and_the_names_of_their_channels(path, value, names) -> None:
    found, told = reader("sensor_msgs/msg/JointState", path)(joints(header={"stamp": 3.5}))
    np.testing.assert_array_equal(found, value)
    assert told == names


def test_a_path_goes_through_lists_of_messages_and_fixed_arrays() -> None:
    markers = messages.create("geometry_msgs/msg/PoseArray", {"poses": [{}, {"position": {"y": 4.0}}]})
    assert reader("geometry_msgs/msg/PoseArray", ("poses", 1, "position", "y"))(markers) == (4.0, ())
    with pytest.raises(UnusableMessage, match="poses has 2 entries, not 3"):
        reader("geometry_msgs/msg/PoseArray", ("poses", 2, "position", "y"))(markers)
    with pytest.raises(MessageError, match="expected an index from 0 to 35, got 36"):
        reader("geometry_msgs/msg/PoseWithCovariance", ("covariance", 36))


def test_names_are_found_again_when_the_order_changes_and_missed_when_one_is_gone() -> None:
    read_wrist = reader("sensor_msgs/msg/JointState", ("effort", "wrist"))
    assert read_wrist(joints())[0] == 2.0
    assert read_wrist(joints(name=["wrist", "elbow"]))[0] == 1.0
    with pytest.raises(UnusableMessage, match="wrist is not among its names: elbow, hand"):
        read_wrist(joints(name=["elbow", "hand"]))
    with pytest.raises(UnusableMessage, match="effort has 1 values, not 2"):
        read_wrist(joints(effort=[1.0]))


def test_messages_are_put_together_from_several_outputs() -> None:
    paths = [("effort", "wrist"), ("effort", "elbow"), ("position", 1), ("position", 0)]
    made = writer("sensor_msgs/msg/JointState", paths).message([1.0, 2.0, 3.0, 4.0], 0.5)
    assert made.name == ["wrist", "elbow"]
    assert (made.effort.tolist(), made.position.tolist(), made.header.stamp.nanosec) == ([1, 2], [4, 3], 500_000_000)


def test_a_whole_array_takes_its_names_along() -> None:
    made = writer("sensor_msgs/msg/JointState", [("effort",)]).message([np.array([1.0, 2.0])], 0.0, ("a", "b"))
    assert (made.name, made.effort.tolist()) == (["a", "b"], [1.0, 2.0])
    made = writer("sensor_msgs/msg/JointState", [("name",), ("effort",)]).message([["w"], 1.5], 0.0)
    assert (made.name, made.effort.tolist()) == (["w"], [1.5])


def test_nested_fields_empty_messages_and_numbers_of_numpy_are_written() -> None:
    made = writer("geometry_msgs/msg/TwistStamped", [("twist", "linear", "x")]).message([np.float64(2)], 1.0)
    assert (made.twist.linear.x, made.header.stamp.sec) == (2.0, 1)
    assert writer("std_msgs/msg/Empty", [()]).message([True], 1.0)
    assert writer("std_msgs/msg/Bool", [("data",)]).message([np.bool_(True)], 1.0).data is True
    assert writer("std_msgs/msg/Int32", [("data",)]).message([np.int64(3)], 1.0).data == 3


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("Name: !!timestamp 2026-13-45", "is not valid YAML: month must be in 1..12"),
        ("Name: !!int x", "is not valid YAML"),
        ("Name: !!bool maybe", "is not valid YAML"),
        ("Frequency: !!float x", "is not valid YAML"),
        ("[\n" * 1200, "nested too deeply"),
        ("Inputs: {}\nInputs: {}", ":2: Inputs: is given twice"),
        (
            "Processor: {Class: LowPass, Parameters: {cutoff: 1, cutoff: 2}}",
            ":1: Processor.Parameters.cutoff: is given twice",
        ),
    ],
)
def test_whatever_yaml_makes_of_a_file_is_one_line_with_the_file(text: str, why: str, tmp_path: Path) -> None:
    from fame.monitor.anomaly.learning_file import load as load_learning
    from fame.monitor.kinematics import load_chain

    (tmp_path / "wrong.yaml").write_text(text)
    for read in (load, load_learning, load_chain):
        with pytest.raises(ConfigError, match=re.escape(why)) as caught:
            read(tmp_path / "wrong.yaml")
        assert "wrong.yaml" in str(caught.value)
        assert "\n" not in str(caught.value)
