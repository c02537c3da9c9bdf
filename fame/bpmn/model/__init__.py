"""The neutral model of a .bpmn file, as frozen dataclasses.

The reader creates it for every dialect; all other packages use it. Names are those of BPMN 2.0. Expressions are text
with a language; `fame.scripting` compiles them. Flow nodes refer to each other by id. Every element has the line of its
opening tag in the file (1-based, 0 if unknown).

::

    definitions    a file: processes, pools, message flows, the drawing
    flow_nodes     what a scope runs: events, gateways, activities, sequence flows
    elements       what these are made of: expressions, data, topics, event definitions
    forms          what a person fills in at a task
"""

from fame.bpmn.model.definitions import (
    Artifact,
    Bounds,
    Definitions,
    Edge,
    MessageFlow,
    ModelFault,
    Note,
    Participant,
    Process,
    Shape,
)
from fame.bpmn.model.elements import (
    EMPTY,
    Assignment,
    CancelDefinition,
    CompensateDefinition,
    ConditionalDefinition,
    DataObject,
    Element,
    ErrorDefinition,
    EscalationDefinition,
    EventDefinition,
    Expression,
    IoMapping,
    Language,
    LinkDefinition,
    MessageDefinition,
    SignalDefinition,
    TerminateDefinition,
    Text,
    TimerDefinition,
    Topic,
    Use,
)
from fame.bpmn.model.flow_nodes import (
    GATEWAYS,
    PLACES,
    TASKS,
    Activity,
    Body,
    CallActivity,
    Event,
    EventPosition,
    FlowNode,
    Gateway,
    GatewayKind,
    MultiInstance,
    SequenceFlow,
    StandardLoop,
    SubProcess,
    Task,
    TaskKind,
)
from fame.bpmn.model.forms import NOBODY, FieldKind, FormField, Human

__all__ = [
    "EMPTY",
    "GATEWAYS",
    "NOBODY",
    "PLACES",
    "TASKS",
    "Activity",
    "Artifact",
    "Assignment",
    "Body",
    "Bounds",
    "CallActivity",
    "CancelDefinition",
    "CompensateDefinition",
    "ConditionalDefinition",
    "DataObject",
    "Definitions",
    "Edge",
    "Element",
    "ErrorDefinition",
    "EscalationDefinition",
    "Event",
    "EventDefinition",
    "EventPosition",
    "Expression",
    "FieldKind",
    "FlowNode",
    "FormField",
    "Gateway",
    "GatewayKind",
    "Human",
    "IoMapping",
    "Language",
    "LinkDefinition",
    "MessageDefinition",
    "MessageFlow",
    "ModelFault",
    "MultiInstance",
    "Note",
    "Participant",
    "Process",
    "SequenceFlow",
    "Shape",
    "SignalDefinition",
    "StandardLoop",
    "SubProcess",
    "Task",
    "TaskKind",
    "TerminateDefinition",
    "Text",
    "TimerDefinition",
    "Topic",
    "Use",
]  # fmt: skip
