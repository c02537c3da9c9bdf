"""Every row of the formats that FAME reads: a model in tests/models/formats, and what it does.

tests/models/README.md is the table: row, model, test.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest

import fame
from fame.bpmn.pools import assign_pools, pools_of
from fame.bpmn.split import extract_process, split
from fame.check import check
from fame.clock import SECOND
from fame.errors import ConfigError, ModelError
from fame.middleware import messages
from fame.robot import Event
from fame.scenario import Scenario

MODELS = Path(__file__).parent / "models"
FORMATS = MODELS / "formats"
VECTOR, BOOL, INT = "geometry_msgs/msg/Vector3", "std_msgs/msg/Bool", "std_msgs/msg/Int32"


class Play:
    """A model on robot REX, beside a node that hears topics, and says things at a time (s)."""

    def __init__(
        self,
        name: str,
        variables: dict[str, Any] | None = None,
        *,
        folder: Path = FORMATS,
        process: str = "P",
        **options: Any,
    ) -> None:
        self.events: list[Event] = []
        self.sim = fame.Simulation(
            fame.read(folder / f"{name}.bpmn"),
            process,
            variables=variables or {},
            robot="REX",
            observer=self.events.append,
            **options,
        )
        self.node = self.sim.middleware.node("peer", "REX")
        self.heard: dict[str, list[Any]] = {}

    def hear(self, **types: str) -> Play:
        """Listen to everybody's topics."""
        for topic, type in types.items():
            self.node.subscription(f"/{topic}", type, self.heard.setdefault(topic, []).append)
        return self

    def say(self, second: float, topic: str, type: str, value: Any = None) -> Play:
        """Publish at that time."""
        publisher = self.node.publisher(topic, type)
        message = messages.create(type, value)
        self.sim.scheduler.at(round(second * SECOND), lambda: publisher.publish(message))
        return self

    def run(self) -> Play:
        """To its end."""
        self.sim.run()
        return self

    @property
    def instance(self) -> fame.Instance:
        (instance,) = self.sim.instances
        return instance

    @property
    def variables(self) -> dict[str, Any]:
        assert [instance.error for instance in self.sim.instances] == [None] * len(self.sim.instances)
        assert self.sim.instances[-1].status == "completed"
        return self.sim.instances[-1].variables

    def times(self, element: str, what: str = "leave") -> list[float]:
        """When an element was completed (s)."""
        return [event.time / SECOND for event in self.events if (event.element, event.what) == (element, what)]

    @property
    def reports(self) -> list[str]:
        return [event.detail for event in self.sim.reports]


def xyz(message: Any) -> tuple[float, float, float]:
    return message.x, message.y, message.z


# ---- the original FaMe -----------------------------------------------------------------------------------------------


def test_g0_a_list_under_the_name_of_the_topic_holds_type_and_payload() -> None:
    play = Play("g0_lists").hear(cmd_vel="geometry_msgs/msg/Twist").say(2, "/arrived", BOOL, True).run()
    assert [message.linear.x for message in play.heard["cmd_vel"]] == [0.5, 0.0]
    assert play.variables["arrived"] is True
    assert play.times("Wait") == [2.0]


def test_g1_types_payloads_and_variables_are_properties() -> None:
    play = Play("g1_properties").hear(go=VECTOR, silent=BOOL, empty=VECTOR)
    play.say(1, "/target_found", VECTOR, {"x": 3.0, "y": 4.0, "z": 5.0}).run()
    assert (play.variables["x_target"], play.variables["y_target"]) == (3.0, 4.0)
    assert [xyz(message) for message in play.heard["go"]] == [(3.0, 4.0, 0.0)]
    assert [message.data for message in play.heard["silent"]] == [False]
    assert [xyz(message) for message in play.heard["empty"]] == [(0.0, 0.0, 0.0)]


def test_g2_elements_of_the_web_modeler_and_a_process_inside_a_call() -> None:
    play = Play("g2_web_modeler").hear(go=VECTOR, horn="std_msgs/msg/String")
    asked: list[str] = []
    play.node.service("tello_action", "tello_msgs/srv/TelloAction", lambda request: asked.append(request.cmd))
    play.say(1, "/target_found", VECTOR, {"x": 3.0}).run()
    assert play.variables["x_target"] == 3.0
    assert asked == ["takeoff"]
    assert [message.data for message in play.heard["horn"]] == ["beep"]
    assert [xyz(message) for message in play.heard["go"]] == [(3.0, 1.0, 0.0)]


def test_g2_policies_one_element_each_are_merged() -> None:
    definitions = fame.read(FORMATS / "g2_web_modeler.bpmn")
    (go,) = (node for node in definitions.processes[0].body.nodes if node.id == "Go")
    assert dict(go.definitions[0].topic.qos) == {
        "history": "keep_all", "reliability": "reliable", "durability": "transient_local",
        "liveliness": "manual_by_topic", "lease_duration": "5", "deadline": "0.5",
    }  # fmt: skip


# ---- rules of reading ------------------------------------------------------------------------------------------------

TOPICS = ("one", "two", "three", "four")


def thrown(name: str, **types: str) -> dict[str, int]:
    """How often each topic was heard."""
    play = Play(name).hear(**types).run()
    assert play.instance.status == "completed"
    return {topic: len(messages) for topic, messages in play.heard.items()}


def test_the_topic_is_the_name_of_the_signal_else_the_label() -> None:
    assert thrown("topics_by_signals", **dict.fromkeys(TOPICS, BOOL)) == dict.fromkeys(TOPICS, 1)
    found = [str(one) for one in check(fame.read(FORMATS / "topics_by_signals.bpmn")) if one.level == "warning"]
    assert [text.partition("): ")[2] for text in found] == [
        "the topic is 'one', the name of the signal, not the label 'one label'"
    ]


def test_with_topics_labels_it_is_the_label() -> None:
    (process,) = fame.read(FORMATS / "topics_by_labels.bpmn").processes
    topics = [node.definitions[0].topic.name for node in process.body.walk() if getattr(node, "definitions", ())]
    assert topics == ["one_label", "two", "three", "four"]


def test_payloads_are_filled_in_at_every_throw_and_become_what_the_type_wants() -> None:
    types = {"json": VECTOR, "yaml": VECTOR, "bool": BOOL, "number": INT, "wrapped": "std_msgs/msg/Float64"}
    types |= dict.fromkeys(("word", "text", "digits"), "std_msgs/msg/String")
    types |= {"array": "std_msgs/msg/Float64MultiArray", "whole": VECTOR, "feel": VECTOR}
    heard = Play("payloads", {"x": 1, "point": {"y": 7.0}}).hear(**types).run().heard
    assert [xyz(message) for message in heard["json"]] == [(2.0, 2.0, 0.0), (3.0, 2.0, 0.0)]
    assert [xyz(message) for message in heard["yaml"]] == [(2.0, 0.0, 3.0), (3.0, 0.0, 3.0)]
    assert [xyz(message) for message in heard["whole"]] == [(0.0, 7.0, 0.0)] * 2
    assert [xyz(message) for message in heard["feel"]] == [(2.0, 4.0, 0.0), (3.0, 6.0, 0.0)]
    values = {name: [message.data for message in heard[name]] for name in types if hasattr(heard[name][0], "data")}
    assert [list(value) for value in values.pop("array")] == [[1.0, 2.0, 2.5], [1.0, 3.0, 2.5]]
    assert values == {
        "bool": [True, True], "number": [3, 4], "wrapped": [2.0, 3.0], "word": ["left, then right"] * 2,
        "text": ["at 2", "at 3"], "digits": ["2", "3"],
    }  # fmt: skip


def test_an_undefined_name_leaves_its_field_at_its_default_with_a_warning() -> None:
    play = Play("undefined_names").hear(position=VECTOR).run()
    assert [xyz(message) for message in play.heard["position"]] == [(0.0, 2.0, 0.0)]
    assert play.reports == ["payload field x: `never_set` is not set; left at its default"]


def test_with_strict_it_is_an_error() -> None:
    play = Play("undefined_names", strict=True).run()
    assert play.instance.status == "failed"
    assert "payload field x: `never_set` is not set" in str(play.instance.error)
    found = check(fame.read(FORMATS / "undefined_names.bpmn"), strict=True)
    assert [one.element for one in found if one.level == "error"] == ["End"]


def test_with_semantics_original_what_was_interrupted_goes_on() -> None:
    play = Play("semantics_original").hear(ended=INT).say(4, "/weed", "std_msgs/msg/Empty").run()
    assert (play.times("Go_On"), play.times("End")) == ([7.0], [10.0])
    assert [message.data for message in play.heard["ended"]] == [1]


def test_without_it_what_was_interrupted_is_over() -> None:
    play = Play("semantics_standard").say(4, "/weed", "std_msgs/msg/Empty").run()
    assert (play.times("Go_On"), play.times("End")) == ([7.0], [])
    assert play.instance.status == "completed"


def test_fields_go_where_a_mapping_a_data_object_or_a_prefix_says() -> None:
    pose = {"pose": {"position": {"x": 1.0, "y": 2.0, "z": 3.0}}, "header": {"frame_id": "map"}}
    stamped = "geometry_msgs/msg/PoseStamped"
    play = (
        Play("caught_fields").say(1, "/mapped", stamped, pose).say(2, "/named", VECTOR, {"x": 5.0, "y": 6.0, "z": 7.0})
    )
    play.say(3, "/nested", stamped, pose).say(4, "/wrapper", "std_msgs/msg/String", "Tractor_1")
    variables = play.say(5, "/prefix", VECTOR, {"x": 8.0, "y": 9.0, "z": 10.0}).run().variables
    assert (variables["height"], "x_ignored" in variables) == (3.0, False)
    assert (variables["x"], variables["y_goal"], "depth" in variables) == (5.0, 6.0, False)
    assert (variables["position"].z, variables["frame_id"]) == (3.0, "map")
    assert variables["tractor_name"] == "Tractor_1"
    assert (variables["y"], variables["z_loose"], "x_min" in variables) == (9.0, 10.0, False)
    assert variables["prefix"].x == 8.0
    warned = [one.text for one in check(fame.read(FORMATS / "caught_fields.bpmn")) if one.element == "Prefix"]
    assert "fills `z_loose` with field z because the names are alike: connect the event with the data object" in warned


def test_a_called_process_is_embedded_or_of_the_file_or_of_the_library() -> None:
    variables = Play("calls").run().variables
    assert {name for name in ("turned", "local", "one", "two") if variables[name]} == {"turned", "local", "one", "two"}


def test_a_called_element_that_is_nowhere_lists_where_it_was_looked_for() -> None:
    with pytest.raises(ModelError) as caught:
        Play("calls_nothing")
    assert caught.value.element == "Call"
    for place in ("neither a process of this file", os.path.relpath(FORMATS), os.path.relpath(FORMATS / "library")):
        assert place in caught.value.text


def test_pools_are_robots_whatever_the_case() -> None:
    definitions = fame.read(FORMATS / "robots.bpmn")
    assert {robot: pool.name for robot, pool in assign_pools(pools_of(definitions), ["REX"]).items()} == {"REX": "rex"}
    result = Scenario.load(FORMATS / "robots.bpmn").run()
    assert result.status == "completed"
    with pytest.raises(ConfigError, match="'REX' and 'Rex' differ in case only"):
        assign_pools(pools_of(definitions), ["REX", "Rex"])


def test_two_pools_that_fall_together_are_named_and_one_without_a_name_goes_by_its_id() -> None:
    with pytest.raises(ModelError, match=r"\(Pool_2\): two pools have the name 'REX'"):
        pools_of(fame.read(FORMATS / "robots_two_alike.bpmn"))
    assert [pool.name for pool in pools_of(fame.read(FORMATS / "robots_unnamed.bpmn"))] == ["Pool_1"]
    notes = {one.element: one.text for one in check(fame.read(FORMATS / "robots.bpmn"))}
    assert notes["Pool_2"].startswith("is a black box")


def test_a_process_waits_for_its_starts_and_every_message_starts_an_instance() -> None:
    play = Play("starts").hear(served=INT)
    for second, number in ((1, 1), (2, 2), (10, 3)):
        play.say(second, "/order", INT, number)
    play.say(4, "/recall", "std_msgs/msg/Empty").run()
    assert [(message.data, time) for message, time in zip(play.heard["served"], play.times("Served"), strict=True)] == [
        (1, 3.0), (2, 4.0), (3, 12.0),
    ]  # fmt: skip
    assert play.times("Recalled") == [4.0]
    assert [instance.status for instance in play.sim.instances] == ["completed"] * 4


def test_the_platform_of_a_file_is_kept_on_rewriting() -> None:
    definitions = fame.read(FORMATS / "platform.bpmn")
    said = b'modeler:executionPlatform="Camunda Platform" modeler:executionPlatformVersion="7.19.0"'
    assert said in extract_process(definitions, "P")
    assert said in split(definitions)[0].source


# ---- JavaScript ------------------------------------------------------------------------------------------------------


def test_the_script_interface_of_the_original() -> None:
    play = Play("javascript").run()
    assert play.variables["steps"] == ["js", "JavaScript", "JavaScript()", "later"]
    assert play.variables["seen"] == ["Scope", "bpmn:ScriptTask", "object", "object", "/REX", "/REX"]
    assert play.variables["output"] == "told"
    assert (play.times("Later"), play.times("End"), play.times("Wrong")) == ([1.5], [1.5], [])
    assert [event.detail for event in play.events if event.what == "log"] == ["hello", "there"]


def test_next_with_an_error_fails_and_events_catch_it() -> None:
    play = Play("javascript_errors").run()
    assert play.times("Charged") == [0.0]
    assert (play.variables["code"], play.variables["why"]) == ("low", "battery at 3 %")


def test_a_script_that_never_calls_next_is_reported() -> None:
    play = Play("javascript_never").run()
    assert play.instance.status == "failed"
    error = play.instance.error
    assert isinstance(error, fame.MissionError)
    assert (error.element, error.line, Path(error.file).name) == ("Do", 7, "javascript_never.bpmn")
    assert "next()" in error.text


def test_ros_node_publishes_subscribes_and_asks_relative_to_the_robot() -> None:
    play = Play("javascript_robot").hear(**{"REX/cmd_vel": "geometry_msgs/msg/Twist", "everyone": BOOL})
    play.node.service("light", "std_srvs/srv/SetBool", lambda request: {"message": f"on: {request.data}"})
    for second, word in ((1, "a"), (2, "enough"), (3, "never")):
        play.say(second, "words", "std_msgs/msg/String", word)
    play.run()
    assert play.variables["heard"] == ["a", "enough"]
    assert play.variables["light"] == "on: True"
    assert [message.linear.x for message in play.heard["REX/cmd_vel"]] == [0.5]
    assert [message.data for message in play.heard["everyone"]] == [True]


# ---- Camunda ---------------------------------------------------------------------------------------------------------


def test_camunda_7_mappings_calls_collections_results_and_errors() -> None:
    mown: list[str] = []
    services = {"mow": lambda variables: mown.append(variables["field"])}
    play = Play("camunda_7", {"base": 2, "fields": ["north", "south"]}, services=services).run()
    variables = play.variables
    assert (variables["sum"], variables["text"]) == (3 + 20 + 2 + 2, "sum of the field")
    assert not {"a", "b", "list", "map"} & variables.keys()
    assert (variables["doubled"], variables["renamed"]) == (2 * 27 + 2, 56)
    assert mown == ["north", "south"]
    assert variables["size"] == "big"
    assert (variables["code"], variables["why"]) == ("lost", "no signal")
    assert play.times("Saved") == [0.0]


def test_camunda_8_scripts_jobs_calls_loops_and_conditions() -> None:
    widths: list[Any] = []
    services = {"mow": lambda variables: widths.append(variables["width"])}
    play = Play("camunda_8", {"base": 2, "items": [1, 2, 3]}, services=services).hear(big="std_msgs/msg/Float64").run()
    assert widths == [5]
    assert (play.variables["mown"], play.variables["added"], play.variables["renamed"]) == (50, 51, 51)
    assert play.variables["values"] == [2, 4, 6]
    assert "width" not in play.variables
    assert "result" not in play.variables
    assert [message.data for message in play.heard["big"]] == [51.0]
    (mow,) = (node for node in fame.read(FORMATS / "camunda_8.bpmn").processes[0].body.nodes if node.id == "Mow")
    assert dict(mow.properties) == {"unit": "m"}


def test_the_language_of_a_text_is_told_by_what_is_said_and_how_it_looks() -> None:
    play = Play("languages", {"x": 2, "list": [5]}).run()
    assert (play.times("End"), play.times("Wrong")) == ([2.0], [])


def test_another_language_is_an_error_that_names_the_accepted_forms() -> None:
    with pytest.raises(ModelError) as caught:
        fame.Simulation(fame.read(FORMATS / "language_unknown.bpmn"))
    assert caught.value.text == ("language 'groovy': expected python (the default), javascript, ${...} or =...")
    assert (caught.value.element, caught.value.line) == ("Do", 7)


def test_what_has_no_effect_is_noted() -> None:
    notes = [one.text for one in check(fame.read(FORMATS / "ignored.bpmn")) if one.text.endswith("has no effect")]
    names = ("jobPriority", "initiator", "asyncBefore")
    assert sorted(notes) == sorted(f"camunda:{name} has no effect" for name in names)


@pytest.mark.parametrize(
    ("name", "said"),
    [("class", "Java class com.acme.Mower"), ("delegate", "delegate expression ${mower}"),
     ("connector", "runs a connector"), ("dmn", "DMN decision dish")],
)  # fmt: skip
def test_what_cannot_run_is_refused_by_name(name: str, said: str) -> None:
    with pytest.raises(ModelError) as caught:
        Play(f"refused_{name}")
    assert said in caught.value.text
    assert caught.value.element == "Do"


# ---- the table -------------------------------------------------------------------------------------------------------


def test_the_table_names_each_model_and_each_test() -> None:
    table = (MODELS / "README.md").read_text("utf-8")
    linked = re.findall(r"\]\(([\w/.]+)\)", table)
    assert [path for path in linked if not (MODELS / path).is_file()] == []
    models = {str(path.relative_to(MODELS)) for path in MODELS.rglob("*.bpmn")}
    assert sorted(models - {path for path in linked if path.endswith(".bpmn")}) == []
    tests = set(re.findall(r"^def (test_\w+)", "".join(path.read_text() for path in MODELS.parent.glob("*.py")), re.M))
    assert sorted(set(re.findall(r"`(test_\w+)`", table)) - tests) == []
