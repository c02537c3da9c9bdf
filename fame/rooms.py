"""The rooms around the core, and what FAME uses of them: places ``module:Name``, imported on use.

The core is every module that belongs to none of `ROOMS`. It imports no module of a room by an import statement
(tests/test_layers.py): what it uses of one is named in a table here, and `load` imports it. So a room can be taken
away; what needs it then says so in one line. Rooms import the core and each other. What other packages add to FAME
they register by entry points (docs/extending.md), which replace nothing that is named here.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

from fame.errors import UnavailableError


class Room(NamedTuple):
    """A room: the packages and modules that belong to it, what it is for, and the extra that installs what it needs."""

    modules: tuple[str, ...]
    about: str
    extra: str = ""


ROOMS: Mapping[str, Room] = {
    "view": Room(("fame.view", "fame.cli.view"), "the page that shows a mission", "view"),
    "draw": Room(
        (
            *("fame.bpmn.draw", "fame.scenario.films", "fame.scenario.film_diagram"),
            *("sim2d.animation", "sim2d.canvas", "sim2d.record", "fame.cli.draw"),
        ),
        "models, runs and worlds as pictures and films",
    ),
    "campaign": Room(("fame.campaign", "fame.cli.campaign"), "many runs of a scenario, with statistics", "campaign"),
    "mining": Room(("fame.mining",), "recordings as event logs for process mining, tables, and bags of ROS 2"),
    "fleet": Room(("fame.fleet", "fame.cli.fleet"), "robots in the field, their health and recordings"),
    "foxglove": Room(("fame.log.foxglove",), "a team live in Foxglove", "foxglove"),
    "edit": Room(("fame.edit", "fame.cli.edit", "fame.cli.diff"), "models compared, and drawn in the browser", "view"),
    "testing": Room(("fame.testing", "fame.cli.testing"), "tests of missions", "test"),
    "monitor": Room(("fame.monitor", "robots.arm", "fame.cli.monitor"), "learned models", "ml"),
    "explore": Room(
        ("fame.check.explore", "fame.scenario.explore", "fame.cli.exploration"),
        "every reachable state of a collaboration",
    ),
    "layout": Room(("fame.layout",), "diagrams of models that have none"),
    "judge": Room(
        (
            *("fame.properties.judge", "fame.scenario.judging", "fame.log.judge", "fame.log.live_judge"),
            *("fame.log.bags", "fame.log.event_logs", "fame.log.recorded_events", "fame.log.xes_reading"),
            *("fame.log.bag_reader", "fame.log.property_watch", "fame.log.team_judge", "fame.cli.judging"),
        ),
        "properties of a team, judged in runs, logs and on the network",
    ),
    "dds": Room(("fame.middleware.dds",), "the network of ROS 2, without ROS", "dds"),
    "zenoh": Room(("fame.middleware.zenoh", "fame.cli.router"), "the network of rmw_zenoh, without ROS", "zenoh"),
    "ros": Room(("fame.middleware.ros", "fame.middleware.self_echo_filter"), "nodes of rclpy, inside a ROS 2 system"),
    "javascript": Room(("fame.scripting.javascript",), "scripts and conditions in JavaScript", "js"),
    "feel": Room(
        ("fame.scripting.feel", "fame.scripting.juel", "fame.scripting.grammar", "fame.scripting.signatures"),
        "expressions of Camunda: = and ${}",
    ),
}


def room_of(module: str) -> str:
    """Return the room that a module belongs to; empty for one of the core.

    >>> room_of("fame.monitor.services"), room_of("fame.robot")
    ('monitor', '')
    """
    homes = ((name, home) for name, room in ROOMS.items() for home in room.modules)
    return next((name for name, home in homes if f"{module}.".startswith(f"{home}.")), "")


def load(place: str) -> Any:
    """Return what is at a place of these tables. Raises UnavailableError if its room was taken away."""
    module, _, name = place.partition(":")
    try:
        return getattr(import_module(module), name)
    except ModuleNotFoundError as error:
        if (reason := missing(error)) is not None:
            raise reason from None
        raise


def install(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'fame-robots[{extra}]'"


def missing(error: BaseException) -> UnavailableError | None:
    """Return what to say of an import that failed since its room was taken away; None for any other error."""
    name = room_of(str(error.name)) if isinstance(error, ModuleNotFoundError) else ""
    if not name:
        return None
    room = ROOMS[name]
    how = install(room.extra) if room.extra else "pip install --force-reinstall fame-robots"
    return UnavailableError(f"this installation lacks {name} ({room.about}): {how}")


# ---- services and processors -----------------------------------------------------------------------------------------


class BuiltInService(NamedTuple):
    """A service that service tasks can name.

    start     the place of its `fame.robot.services.StartService`
    required  variables that it needs
    results   variables that it sets when it ends by itself
    packages  what it imports of extras: a mission that lacks one is refused before it moves
    topics    the place of what gives its topics: (folder, variables) -> `fame.robot.services.ServiceTopic`s, or None
    options   variables that it takes besides
    """

    start: str
    required: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    topics: str = ""
    options: tuple[str, ...] = ()


_LEARNING = ("sklearn", "skops")
_ARM = ("points", "rule", "topic", "field")
WATCH = "watch_property"
SERVICES: Mapping[str, BuiltInService] = {
    "adm_collect": BuiltInService(
        "fame.monitor.services:CollectService",
        ("output", "label"),
        ("runs_collected",),
        topics="fame.monitor.services:collect_topics",
        options=("runs", *_ARM),
    ),
    "adm_learn": BuiltInService(
        "fame.monitor.services:adm_learn",
        ("config",),
        ("classifier",),
        _LEARNING,
        "fame.monitor.services:learn_topics",
        ("model",),
    ),
    "adm_operate": BuiltInService(
        "fame.monitor.services:adm_operate",
        ("model",),
        packages=_LEARNING,
        topics="fame.monitor.services:operate_topics",
        options=("threshold", *_ARM),
    ),
    "process": BuiltInService(
        "fame.monitor.services:process",
        ("configuration",),
        topics="fame.monitor.services:process_topics",
        options=("parameters", "namespace", "blind"),
    ),
    "record": BuiltInService(
        "fame.monitor.services:record",
        ("configuration", "output"),
        topics="fame.monitor.services:record_topics",
        options=("namespace",),
    ),
    WATCH: BuiltInService(
        "fame.log.property_watch:PropertyWatch", ("property", "sentence"), topics="fame.log.property_watch:topics"
    ),
    "train": BuiltInService(
        "fame.monitor.services:train",
        ("configuration",),
        ("model", "thresholds"),
        _LEARNING,
        "fame.monitor.services:train_topics",
    ),
}
"""The services of FAME by name; `fame.monitor.services` says what they do."""


PROCESSORS: Mapping[str, str] = {
    "LowPass": "fame.monitor.pipeline.filters:LowPass",
    "Resample": "fame.monitor.pipeline.filters:Resample",
    "Scale": "fame.monitor.pipeline.filters:Scale",
    "Window": "fame.monitor.pipeline.filters:Window",
    "RMS": "fame.monitor.pipeline.filters:RMS",
    "MovingStatistics": "fame.monitor.pipeline.filters:MovingStatistics",
    "Spectrum": "fame.monitor.pipeline.filters:Spectrum",
    "Estimator": "fame.monitor.pipeline.estimators:Estimator",
    "Autoencoder": "fame.monitor.pipeline.estimators:Autoencoder",
    "Threshold": "fame.monitor.pipeline.threshold:Threshold",
    "Drift": "fame.monitor.drift:Drift",
    "Expression": "fame.monitor.pipeline.formula:Expression",
    "Machine": "fame.monitor.pipeline.polled_source:Machine",
}
"""The processors of FAME by the name that a configuration gives."""


# ---- commands --------------------------------------------------------------------------------------------------------

COMMANDS: Mapping[str, Mapping[str, str]] = {
    "mission": {
        "new": "fame.cli.new:add_new",
        "demo": "fame.cli.new:add_demo",
        "run": "fame.cli.run:add",
        "test": "fame.cli.testing:add",
        "check": "fame.cli.check:add",
        "campaign": "fame.cli.campaign:add",
        "draw": "fame.cli.draw:add",
        "view": "fame.cli.view:add",
    },
    "team": {
        "engine": "fame.cli.engine:add",
        "deploy": "fame.cli.deployment:add_deploy",
        "splitter": "fame.cli.deployment:add_splitter",
        "router": "fame.cli.router:add",
        "status": "fame.cli.robots:add_status",
        "inventory": "fame.cli.fleet.inventory:add",
        **dict.fromkeys(
            (
                "complete",
                "activate",
                "abort",
                "retry",
                "suspend",
                "take-over",
                "continue",
                "skip",
                "restart",
                "fail",
                "set",
                "move",
            ),
            "fame.cli.robots:add_requests",
        ),
        "world": "fame.cli.worlds:add_world",
        **dict.fromkeys(("pause", "resume"), "fame.cli.worlds:add_time"),
        "keys": "fame.cli.deployment:add_keys",
        "doctor": "fame.cli.fleet.doctor:add",
    },
    "monitor": {
        "record": "fame.cli.monitor.pipelines:add_record",
        "train": "fame.cli.monitor.pipelines:add_train",
        "process": "fame.cli.monitor.pipelines:add_process",
        "judge": "fame.cli.monitor.models:add_judge",
        "model": "fame.cli.monitor.models:add_model",
        "export": "fame.cli.monitor.export:add_export",
        "label": "fame.cli.monitor.labelling:add_label",
        "retrain": "fame.cli.monitor.labelling:add_retrain",
        "adm": "fame.cli.monitor.adm:add",
    },
    "log": {"log": "fame.cli.logs:add"},
    "tools": {
        "edit": "fame.cli.edit:add",
        "diff": "fame.cli.diff:add",
        "split": "fame.cli.models:add_split",
        "layout": "fame.cli.models:add_layout",
        "convert": "fame.cli.models:add_convert",
        "library": "fame.cli.models:add_library_command",
        "templates": "fame.cli.models:add_templates",
        "topic": "fame.cli.monitor.ros:add_topic",
        "param": "fame.cli.monitor.ros:add_param",
        "unit": "fame.cli.fleet.unit:add",
        "completion": "fame.cli.completion:add",
        "docs": "fame.cli.docs:add",
    },
}
"""The function that declares each command, by group. A module is imported when one of its commands is asked for: an
engine starts without what the other commands need. Commands of a team are also parts of ``fame team``; those of
monitors are only parts of ``fame monitor``, and their names alone are old."""


# ---- languages and middlewares ---------------------------------------------------------------------------------------

LANGUAGES: Mapping[str, str] = {
    "feel": "fame.scripting.feel.language:parse_feel",
    "javascript": "fame.scripting.javascript:compile_javascript",
    "juel": "fame.scripting.juel:parse_juel",
}
"""What parses an expression (text -> `fame.scripting.data.Parsed`), or compiles a text as `compile_script` does."""
EFFECTS: Mapping[str, str] = {"javascript": "fame.scripting.javascript.effects:JavaScriptEffects"}
"""The `fame.scripting.effects.Effects` of texts in the language of a room that do more than compute a value."""
MIDDLEWARES: Mapping[str, str] = {
    "dds": "fame.middleware.dds:DdsMiddleware",
    "zenoh": "fame.middleware.zenoh:ZenohMiddleware",
    "ros": "fame.middleware.ros:RosMiddleware",
}
"""FAME's own backends between processes: each makes a `fame.middleware.interface.Middleware`."""


# ---- what else the core uses of rooms --------------------------------------------------------------------------------

ADD_DIAGRAM = "fame.layout:add_diagram"
FEEL_FUNCTIONS = "fame.scripting.feel.language:FUNCTIONS"
CHECK_DRAWINGS = "fame.cli.draw:check_drawings"
COLLECT = "fame.cli.fleet.collection:add"
CONFIGURED_FILES = "fame.monitor.services:configured_files"
CONVERT_RECORDING = "fame.mining.conversion:convert"
DDS_RELAY = "fame.middleware.dds.relay:Relay"
DDS_RELAYED = "fame.middleware.dds.relayed:RelayedMiddleware"
DDS_TYPE = "fame.middleware.dds.wire:declared"
DIAGNOSTICS = "fame.fleet.diagnostics:DiagnosticsPublisher"
DRAW = "fame.bpmn.draw.diagram:draw"
DRAW_RUN = "fame.cli.draw:draw_run"
ENGINE_LOG = "fame.fleet.engine_log:EngineLog"
EXPLORE_FOUND = "fame.scenario.explore.exploration:explore_found"
EXPLORE_MIGRATED = "fame.scenario.explore.exploration:explore_migrated"
EXPLORE_OBJECTION = "fame.scenario.explore.exploration:objection"
EXPLORE_OPTIONS = "fame.cli.exploration:add_arguments"
EXPLORE_RUN = "fame.cli.exploration:run"
FINDING_AS_JSON = "fame.cli.exploration:finding_as_json"
FOXGLOVE = "fame.log.foxglove:FoxgloveServer"
JAVASCRIPT_HOST = "fame.scripting.javascript:HostApi"
JUDGE_COMMAND = "fame.cli.judging:judge"
JUDGE_FOR = "fame.cli.judging:live_judge"
JUDGE_LOG = "fame.log.judge:judge_log"
LAY_OUT = "fame.layout:lay_out"
LOG_SERVER = "fame.fleet.log_server:LogServer"
MARKERS = "fame.fleet.markers:MarkerPublisher"
METRICS = "fame.fleet.metrics:serve_metrics"
MONITOR_INPUTS = "fame.cli.monitor.models:add_inputs"
MONITOR_LABEL = "fame.cli.monitor.labelling:label_on_page"
MONITOR_ON_PAGE = "fame.cli.monitor.models:judged_on_page"
RUN_JUDGE = "fame.scenario.judging:RunJudge"
RUN_WATCHES = "fame.scenario.judging:RunWatches"
TEAM_VOCABULARY = "fame.scenario.judging:team_vocabulary"
TOPICS_READ = "fame.scenario.judging:topics_read"
VIEW_ADDRESS = "fame.cli.view:add_address"
VIEW_OPTIONS = "fame.cli.view:add_page"
VIEW_RUN = "fame.cli.view:viewed"
VIEW_SERVING = "fame.cli.view:serving"
VIEW_WAIT = "fame.cli.view:wait_for_interrupt"
WRITE_RECORDING = "fame.view.page_file:write_recording"
XES = "fame.mining.xes:xes"
ZENOH_MEETING = "fame.middleware.zenoh.session:take_over"
