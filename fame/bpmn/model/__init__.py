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
    Artifact as Artifact,
    Bounds as Bounds,
    Definitions as Definitions,
    Edge as Edge,
    MessageFlow as MessageFlow,
    ModelFault as ModelFault,
    Note as Note,
    Participant as Participant,
    Process as Process,
    Shape as Shape,
)
from fame.bpmn.model.elements import (
    EMPTY as EMPTY,
    Assignment as Assignment,
    CancelDefinition as CancelDefinition,
    CompensateDefinition as CompensateDefinition,
    ConditionalDefinition as ConditionalDefinition,
    DataObject as DataObject,
    Element as Element,
    ElementOutcome as ElementOutcome,
    ErrorDefinition as ErrorDefinition,
    EscalationDefinition as EscalationDefinition,
    EventDefinition as EventDefinition,
    Expression as Expression,
    IoMapping as IoMapping,
    Language as Language,
    LinkDefinition as LinkDefinition,
    MessageDefinition as MessageDefinition,
    SignalDefinition as SignalDefinition,
    TerminateDefinition as TerminateDefinition,
    Text as Text,
    TimerDefinition as TimerDefinition,
    Topic as Topic,
    Use as Use,
)
from fame.bpmn.model.flow_nodes import (
    GATEWAYS as GATEWAYS,
    PLACES as PLACES,
    TASKS as TASKS,
    Activity as Activity,
    Body as Body,
    CallActivity as CallActivity,
    Event as Event,
    EventPosition as EventPosition,
    FlowNode as FlowNode,
    Gateway as Gateway,
    GatewayKind as GatewayKind,
    MultiInstance as MultiInstance,
    SequenceFlow as SequenceFlow,
    StandardLoop as StandardLoop,
    SubProcess as SubProcess,
    Task as Task,
    TaskKind as TaskKind,
    ids_named as ids_named,
)
from fame.bpmn.model.forms import NOBODY as NOBODY, FieldKind as FieldKind, FormField as FormField, Human as Human
