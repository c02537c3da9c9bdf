"""The extension properties that FAME defines, by the elements that have them: what checks know and the reference shows.

Meanings are Markdown. Properties with other names are kept in the file and have no effect; those of a data object are
its variables.
"""

from __future__ import annotations

from collections.abc import Mapping

THROWS = "Events and send tasks that throw a signal or message"
CATCHES = "Events and receive tasks that catch a signal or message"
TIMERS = "Timer events"
SERVICES = "Service tasks"
EVENT_SUB_PROCESSES = "Event sub-processes"
AD_HOC = "Ad-hoc sub-processes"
REPETITIONS = "Multi-instance activities, or their loops"
PROCESSES = "Processes"
ANY = "Any activity, event or process"
_MESSAGE = {
    "type": "message type, `pkg/msg/Type`; one element per topic is enough",
    "scope": "`robot`: the topic belongs to the robot, `/NAME/topic`",
    "qos.POLICY": "reliability, durability, history, depth, deadline, lifespan, liveliness or lease_duration of ROS 2",
}
PROPERTIES: Mapping[str, Mapping[str, str]] = {
    THROWS: {
        **_MESSAGE,
        "payload": "the message: flow-style YAML or JSON that may contain `${...}`, a single value, or `=...` (FEEL)",
        "to": "of a message: the robot that receives it, `${closest}`, `Tractor_${n}` or a name; without it, all do",
        "delivery": "`acknowledged`: keep each signal until every robot that catches it has acknowledged it",
        "ttl": "seconds in which an acknowledged signal has to arrive (60)",
    },
    CATCHES: {
        **_MESSAGE,
        "queue": "number of messages to keep from the time the scope is entered",
        "correlate": "variables that the message must match: `order_id`, or `order_id = key` for the field `key`",
        "outside": "who publishes a signal that no robot throws, for `fame check --explore`",
    },
    TIMERS: {
        "missed": "if the timer was due while the engine was not running: `fire` (default), `skip`, or `fail`, which "
        "is the error `missed`"
    },
    SERVICES: {
        "service": "the name of a ROS service",
        "action": "the name of a ROS action",
        "type": "its type: `pkg/srv/Type` or `pkg/action/Type`",
        "payload": "the request or goal, as the payload of a signal",
        "scope": "`robot`: the service or action belongs to the robot",
        "feedback": "variables that receive the feedback of an action, with commas: one named like a field receives it",
        "errors": "codes of BPMN errors by outcome or `error_code` of the result: `{rejected: busy, 208: no_path}`",
        "wait_cancelled": "seconds to wait until cancelled goals of the action have ended; then it is the error "
        "`still_running`. Without it the goal is sent at once",
        "retry": "a request that was in progress when engine or server left, or its mission was suspended: "
        "`safe` (default) sends it again, `never` is the error `lost`, `ask` waits for somebody",
    },
    EVENT_SUB_PROCESSES: {"resume": "`true`: suspend the scope and resume it afterwards, instead of cancelling it"},
    AD_HOC: {
        "activities": "ids of the elements to start: a list, as `${...}`, `=...` or a variable; without it, all start"
    },
    REPETITIONS: {
        "outputCollection": "variable that receives the list of results",
        "outputElement": "expression for the result of each instance: `${distance}`",
    },
    PROCESSES: {
        "instances": "maximum number of instances that have not ended",
        "optional": "`true`: the mission can complete although no robot has started the process",
        "semantics": "`original`: all interrupting event sub-processes suspend and resume, as in the original FaMe",
        "topics": "`labels`: the labels of events name their topics, instead of their signals",
        "fields": "`prefix` or `associations`: whether a message sets variables whose names begin with the names of "
        "its fields where no data object is connected; `prefix` is the default in files of the original FaMe",
    },
    ANY: {
        "deadline": "a duration: it is left within this time after it was entered (`PT5S`); judged as a property",
        "requirement": "the id of what it is for, in `fame check --report`",
        "accept": "findings of `fame check --explore` that are known and right: `KIND: REASON; ...`",
    },
}
