"""Processing nodes: samples in, messages out, bad data left out and reported, parameters changed while they run."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MessageError, MissionError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.monitor.pipeline.configuration import load
from fame.monitor.pipeline.input_node import ThrottledReport
from fame.monitor.pipeline.node import ProcessingNode
from fame.monitor.pipeline.parameters import ParameterClient
from fame.monitor.pipeline.processor import Parameter, Samples

JOINT_STATE = "sensor_msgs/msg/JointState"
EFFORTS = {"Topic": "joint_states", "Field": ["effort"], "MessageType": JOINT_STATE}
FILTERED = {"Topic": "filtered", "Field": ["effort"], "MessageType": JOINT_STATE}
LOW_PASS = {"Class": "LowPass", "Parameters": {"cutoff": 20}}


class Bench:
    """A node on simulated time; an arm that publishes; whoever listens."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.scheduler = folder, Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.outside = self.middleware.node("arm")
        self.arm = self.outside.publisher("joint_states", JOINT_STATE)
        self.said: list[str] = []

    def node(self, processors: Any = None, **sections: Any) -> ProcessingNode:
        path = self.folder / "unit.yaml"
        given = {"Inputs": {"Efforts": EFFORTS}, "Outputs": {"Filtered": FILTERED}, "Processor": LOW_PASS, **sections}
        path.write_text(yaml.safe_dump({name: value for name, value in given.items() if value is not None}))
        return ProcessingNode(
            self.middleware, self.scheduler, load(path), processors=processors, report=self.said.append
        )

    def hear(self, topic: str, type: str = JOINT_STATE) -> list[Any]:
        heard: list[Any] = []
        self.outside.subscription(topic, type, heard.append)
        return heard

    def say(self, stamp: float, *effort: float, name: Any = ("elbow", "wrist")) -> None:
        """One message, at a stamp of its header."""
        self.arm.publish(
            messages.create(JOINT_STATE, {"header": {"stamp": stamp}, "name": list(name), "effort": list(effort)})
        )

    def move(self, seconds: float, rate: float = 500.0, effort: Callable[[float], Any] = lambda t: (t, 2 * t)) -> None:
        """Messages at a rate for some time."""
        begin = self.scheduler.now
        for number in range(1, round(seconds * rate) + 1):
            self.scheduler.run(begin + round(number * SECOND / rate))
            now = self.scheduler.now / SECOND
            self.say(now, *effort(now))

    def run(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


class Recorder:
    """Keeps what it is given."""

    outputs = ("Filtered",)

    def __init__(self) -> None:
        self.calls: list[dict[str, Samples]] = []

    def execute(self, inputs: Any) -> Any:
        self.calls.append(dict(inputs))


def test_every_sample_comes_out_with_its_stamp_and_the_names_of_its_channels(bench: Bench) -> None:
    bench.node()
    heard = bench.hear("filtered")
    bench.move(0.1)
    bench.run(0.1)
    assert len(heard) == 50
    assert heard[0].name == ["elbow", "wrist"]
    assert heard[0].header.stamp.nanosec == 2_000_000
    assert heard[-1].effort[1] == pytest.approx(2 * heard[-1].effort[0])
    assert bench.said == []


def test_a_processor_gets_what_arrived_since_the_last_call(bench: Bench) -> None:
    recorder = Recorder()
    bench.node([recorder], Frequency=50)
    bench.move(0.06)
    bench.run(0.1)
    assert [len(call["Efforts"]) for call in recorder.calls] == [9, 10, 10, 1]
    first = recorder.calls[0]["Efforts"]
    assert first.values.shape == (9, 2)
    assert first.names == ("Efforts.elbow", "Efforts.wrist")
    np.testing.assert_allclose(first.stamps, np.arange(1, 10) * 0.002)


def test_a_bare_value_is_published_once_a_call_and_nothing_if_there_is_none(bench: Bench) -> None:
    class Latest:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            (efforts,) = inputs.values()
            return {"Filtered": efforts.values[-1]} if efforts.values[-1][0] > 0.05 else None

    bench.node([Latest()])
    heard = bench.hear("filtered")
    bench.move(0.1)
    assert [message.header.stamp.nanosec for message in heard] == [58_000_000, 78_000_000, 98_000_000]


def test_what_a_published_processor_does_not_declare_is_given_by_name(bench: Bench) -> None:
    class Undeclared:
        def execute(self, inputs: Any) -> Any:
            return {"filtered": inputs["Efforts"]}

    class Wrong:
        def execute(self, inputs: Any) -> Any:
            return {"a": 1.0, "b": 2.0}

    bench.node([Undeclared()])
    heard = bench.hear("filtered")
    bench.node([Wrong()], Name="wrong")
    bench.move(0.1)
    assert len(heard) == 49
    assert "wrong: Outputs.Filtered: no processor computes it; Wrong computes a, b" in bench.said


# ---- bad data --------------------------------------------------------------------------------------------------------


def stamps(heard: list[Any]) -> list[float]:
    return [round(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9, 6) for message in heard]


def test_values_that_are_not_finite_are_left_out_and_reported(bench: Bench) -> None:
    bench.node()
    heard = bench.hear("filtered")
    for number, value in enumerate((1.0, float("nan"), 1.0, float("inf"), 1.0)):
        bench.say(0.1 + number / 500, 1.0, value)
    bench.run(0.1)
    assert stamps(heard) == [0.1, 0.104, 0.108]
    assert bench.said == ["unit: /joint_states: a message is left out: Efforts is not finite"]


def test_samples_out_of_order_and_twice_are_left_out_and_reported(bench: Bench) -> None:
    bench.node()
    heard = bench.hear("filtered")
    for stamp in (0.1, 0.2, 0.15, 0.2, 0.3):
        bench.say(stamp, 1.0, 2.0)
    bench.run(0.1)
    assert stamps(heard) == [0.1, 0.2, 0.3]
    assert bench.said == ["unit: /joint_states: left out: a sample 0.05 s older of stamp 0.150 s after 0.200 s"]


def test_no_window_spans_what_a_clock_that_jumps_back_hides(bench: Bench) -> None:
    bench.node()
    heard = bench.hear("filtered")
    for stamp in (0.1, 0.2, 0.3, 0.4, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        bench.say(stamp, 1.0, 1000 * stamp)
    bench.run(0.1)
    assert stamps(heard) == [0.1, 0.2, 0.3, 0.4, 0.8, 0.9]  # as long a gap as that in the motion
    assert bench.said[-1] == "unit: /joint_states: left out: the clock jumped back by 0.3 s, and no window spans that"


def test_messages_that_come_late_leave_no_gap(bench: Bench) -> None:
    bench.node()
    heard = bench.hear("filtered")
    for stamp in (0.1, 0.2, 0.4, 0.3, 0.35, 0.5):
        bench.say(stamp, 1.0, 2.0)
    bench.run(0.1)
    assert stamps(heard) == [0.1, 0.2, 0.4, 0.5]


def test_a_late_message_is_reported(bench: Bench) -> None:
    bench.node()
    bench.move(0.1)
    bench.run(3)
    bench.say(0.5, 1.0, 2.0)
    bench.run(0.1)
    assert any("late: a message took 2.6 s longer than others" in text for text in bench.said)


def test_a_joint_that_is_missing_is_named_and_the_node_goes_on(bench: Bench) -> None:
    bench.node(Inputs={"Efforts": {**EFFORTS, "Field": ["effort", ["elbow", "wrist"]]}})
    heard = bench.hear("filtered")
    bench.say(0.1, 1.0, 2.0)
    bench.say(0.2, 1.0, name=["elbow"])
    bench.say(0.3, 2.0, 1.0, name=["wrist", "elbow"])
    bench.run(0.1)
    assert [message.name for message in heard] == [["elbow", "wrist"]] * 2
    assert bench.said == ["unit: /joint_states: a message is left out: wrist is not among its names: elbow"]


def test_a_rate_twice_the_expected_is_reported_and_so_is_its_end(bench: Bench) -> None:
    bench.node(Inputs={"Efforts": {**EFFORTS, "Rate": 100}})
    bench.move(2.5, 200.0)
    bench.move(3.0, 100.0)
    assert bench.said == [
        "unit: /joint_states: 200 Hz arrive; Rate: 100 is expected",
        "unit: /joint_states: 100 Hz again",
    ]


def test_a_topic_that_stops_is_reported_and_so_is_that_it_goes_on(bench: Bench) -> None:
    bench.node()
    bench.run(3.5)
    bench.move(0.1)
    bench.run(4)
    assert bench.said == [
        "unit: /joint_states: no message for 2 s",
        "unit: /joint_states: messages arrive again",
        "unit: /joint_states: no message for 2 s",
    ]


def test_a_topic_that_nobody_publishes_is_reported(bench: Bench) -> None:
    bench.node(Inputs={"Efforts": {**EFFORTS, "Topic": "joint_state"}})
    bench.run(3.5)
    assert bench.said == ["unit: /joint_state: no message for 2 s: it has no publisher"]


def test_a_topic_with_another_type_is_refused_before_anything_runs(bench: Bench) -> None:
    bench.outside.publisher("filtered", "std_msgs/msg/Float64")
    with pytest.raises(
        MessageError, match=r"topic /filtered carries std_msgs/msg/Float64 \(/arm\); expected sensor_msgs"
    ):
        bench.node()
    assert all(not info.subscribers for info in bench.middleware.graph())


def test_a_processor_that_raises_is_reported_and_called_again(bench: Bench) -> None:
    class Sometimes:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            (efforts,) = inputs.values()
            if efforts.stamps[0] < 0.1:
                raise IndexError("list index out of range")
            return {"Filtered": Samples(1 / efforts.values, efforts.stamps)}

    bench.node([Sometimes()])
    heard = bench.hear("filtered")
    bench.move(0.4)
    assert stamps(heard)[0] == 0.1
    assert bench.said == ["unit: Sometimes raised IndexError: list index out of range; nothing is sent"]


def test_the_same_with_other_numbers_is_said_once(bench: Bench) -> None:
    class Fussy:
        outputs = ("Filtered",)
        report = print

        def execute(self, inputs: Any) -> Any:
            (efforts,) = inputs.values()
            self.report(f"samples at {efforts.stamps[-1]:.3g} Hz")
            raise ValueError(f"found {efforts.stamps[-1]}")

    bench.node([Fussy()])
    bench.move(0.15)
    assert [text.partition(" ")[2].partition(" 0.")[0] for text in bench.said] == [
        "Fussy: samples at", "Fussy raised ValueError: found",
    ]  # fmt: skip


def test_what_is_computed_and_is_not_finite_is_not_sent(bench: Bench) -> None:
    class Inverse:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            (efforts,) = inputs.values()
            with np.errstate(divide="ignore"):
                return {"Filtered": Samples(1 / efforts.values, efforts.stamps)}

    bench.node([Inverse()])
    heard = bench.hear("filtered")
    bench.move(0.1, effort=lambda t: (1.0, 0.0 if 0.03 < t < 0.05 else 1.0))
    bench.run(0.1)
    assert len(heard) == 41
    assert bench.said[0] == "unit: /filtered: not sent: it is not finite"


def test_what_does_not_fit_the_message_is_not_sent(bench: Bench) -> None:
    class Text:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            return {"Filtered": "high"}

    bench.node([Text()])
    bench.move(0.1)
    assert bench.said[0].startswith("unit: /filtered: not sent: sensor_msgs/msg/JointState: effort")


def test_a_processor_slower_than_its_period_misses_calls_and_the_share_is_reported(bench: Bench) -> None:
    class Slow:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            bench.scheduler.now += SECOND // 20  # as a wall clock goes on while it computes

    node = bench.node([Slow()], Frequency=50)
    bench.move(1.0)
    assert node.missed == pytest.approx(node.calls * 1.5, abs=2)
    (said,) = [text for text in bench.said if "slower" in text and "times" not in text]
    assert said.startswith("unit: slower than its period of 20 ms: ")
    assert said.endswith("% of its calls missed")


def test_a_model_of_other_columns_keeps_the_node_alive_and_silent(bench: Bench) -> None:
    from fame.monitor.pipeline.detectors import ChannelAutoencoders
    from fame.monitor.pipeline.estimators import Autoencoder
    from fame.monitor.pipeline.trained_model import TrainedModel

    layers = ChannelAutoencoders(
        (np.zeros((2, 10, 3)), np.zeros((2, 3, 10))), (np.zeros((2, 1, 3)), np.zeros((2, 1, 10))), "tanh"
    )
    model = TrainedModel(("Efforts.a", "Efforts.b"), 10, 500.0, np.zeros(2), np.ones(2), layers, (1.0, 1.0))
    bench.node([Autoencoder(model)])
    heard = bench.hear("filtered")
    bench.move(0.1)
    assert heard == []
    assert bench.said == [
        "unit: Autoencoder raised ValueError: the model was trained on Efforts.a, Efforts.b; "
        "the data are Efforts.elbow, Efforts.wrist; nothing is sent"
    ]


def test_a_node_without_inputs_is_called_all_the_same(bench: Bench) -> None:
    class Source:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            return {"Filtered": [1.0]}

    bench.node([Source()], Inputs=None, Frequency=10)
    heard = bench.hear("filtered")
    bench.run(1.05)
    assert stamps(heard) == [pytest.approx(0.1 * n) for n in range(1, 11)]


def test_what_is_sent_can_go_over_the_wire(bench: Bench) -> None:
    from fame.middleware import codec

    class Turned:
        outputs = ("Filtered",)

        def execute(self, inputs: Any) -> Any:
            (efforts,) = inputs.values()
            return {"Filtered": Samples(np.asfortranarray(efforts.values), efforts.stamps, efforts.names)}

    bench.node([Turned()])
    heard = bench.hear("filtered")
    bench.move(0.1)
    again = [codec.deserialize(codec.serialize(message), JOINT_STATE) for message in heard]
    assert again == heard
    assert again[-1].effort.tolist() == [0.098, 0.196]


# ---- parameters ------------------------------------------------------------------------------------------------------


class Gain:
    """A processor with one parameter of each kind."""

    outputs = ("Filtered",)
    parameters = (
        Parameter("gain", "float", 1.0, (0, 10), "Nm", "what efforts are multiplied by"),
        Parameter("delay", "int", 0, (0, None)),
        Parameter("on", "bool", True),
        Parameter("mode", "str", "fast", ("fast", "slow")),
        Parameter("weights", "floats", (1.0,)),
        Parameter("names", "strs", ()),
        Parameter("model", "file", "", fixed=True),
    )

    def __init__(self) -> None:
        for parameter in self.parameters:
            setattr(self, parameter.name, parameter.default)
        self.gain: float

    def execute(self, inputs: Any) -> Any:
        (efforts,) = inputs.values()
        return {"Filtered": Samples(efforts.values * self.gain, efforts.stamps)}


def client(bench: Bench, name: str = "/unit") -> ParameterClient:
    return ParameterClient(bench.middleware.node("asking"), bench.scheduler, name)


def test_parameters_are_listed_described_and_changed_from_another_node(bench: Bench) -> None:
    bench.node([Gain()])
    heard = bench.hear("filtered")
    asking = client(bench)
    assert asking.names() == ["gain", "delay", "on", "mode", "weights", "names", "model"]
    assert asking.get(asking.names()) == [1.0, 0, True, "fast", [1.0], [], ""]
    described = asking.describe(["gain", "mode", "model"])
    assert described[0].description == "what efforts are multiplied by (Nm)"
    assert described[0].floating_point_range[0].to_value == 10.0
    assert described[1].additional_constraints == "one of fast, slow"
    assert [each.read_only for each in described] == [False, False, True]
    for name, value in (("gain", 3), ("on", False), ("mode", "slow"), ("weights", [1.0, 2.0]), ("names", ["a", "b"])):
        asking.set(name, value)
        assert asking.get([name]) == [value]
    bench.move(0.1, effort=lambda t: (1.0, 2.0))
    assert heard[-1].effort.tolist() == [3.0, 6.0]
    assert "unit: gain is 3.0 now" in bench.said


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("gain", 11.0, "gain: expected a number from 0 to 10 Nm, got 11.0"),
        ("gain", "much", "got 'much'"),
        ("mode", "medium", "expected a text: fast, slow, got 'medium'"),
        ("model", "other.skops", "model: cannot be changed while it runs"),
        ("gian", 1.0, "gian: unknown parameter; known are gain, delay"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_the_reason(bench: Bench, name: str, value: Any, reason: str) -> None:
    node = bench.node([Gain()])
    with pytest.raises(ConfigError) as caught:
        client(bench).set(name, value)
    assert reason in str(caught.value)
    assert node.processors[0].gain == 1.0


def test_parameters_of_a_chain_with_one_name_are_told_apart(bench: Bench) -> None:
    node = bench.node(Processor=[LOW_PASS, {"Class": "LowPass", "Parameters": {"cutoff": 5}}])
    assert client(bench).get(["cutoff", "2.cutoff"]) == [20.0, 5.0]
    client(bench).set("2.cutoff", 7)
    assert [processor.cutoff for processor in node.processors] == [20.0, 7.0]


def test_a_node_that_is_not_there_is_named(bench: Bench) -> None:
    with pytest.raises(MissionError, match="/nobody: no node of that name offers parameters"):
        client(bench, "/nobody").names()


WRONG = {
    "no row": lambda x: Samples(x.values[:0], x.stamps[:0]),
    "more stamps than values": lambda x: Samples(x.values[:1], np.append(x.stamps, 9.0)),
    "a stamp that is no number": lambda x: Samples(x.values, np.full(len(x), np.nan)),
    "a stamp beyond every message": lambda x: Samples(x.values, np.append(x.stamps[:-1], 1e10)),
    "names that are no texts": lambda x: Samples(x.values, x.stamps, (1, 2)),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_node_outlives_whatever_its_processor_gives(bench: Bench, wrong: Callable[[Samples], Samples]) -> None:
    class Own:
        outputs = ("filtered",)
        calls = 0

        def execute(self, inputs: Any) -> Any:
            self.calls += 1
            return {"filtered": wrong(inputs["Efforts"]) if self.calls == 1 else inputs["Efforts"]}

    bench.node([Own()])
    heard = bench.hear("filtered")
    bench.move(0.2)
    assert len(heard) > 50
    assert all(-(2**31) <= message.header.stamp.sec < 2**31 for message in heard)


def test_a_parameter_that_no_message_could_tell_is_refused_before_anything_runs(bench: Bench) -> None:
    for sections in ({"Frequency": 1e-300}, {"Processor": {"Class": "Window", "Parameters": {"stride": 10**30}}}):
        with pytest.raises(ConfigError, match="expected"):
            bench.node(**sections)


def test_what_happens_by_the_thousand_is_counted_and_said_a_few_times() -> None:
    said: list[str] = []
    report = ThrottledReport(said.append)
    for _ in range(35_000):
        report("late /joint_states", "late")
    assert said == ["late", *(f"late ({number} times)" for number in (10, 100, 1000, 10000))]
