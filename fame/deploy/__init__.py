"""Deployment: send robots their processes over topics, all or none (docs/deployment.md).

An `EngineNode` is a robot's end: it receives its process on ``/<robot>/bpmn_process`` and reports on
``/<robot>/bpmn_status``. A `Deployment` is the sender's end: it sends every robot its part and waits for each answer.

Two phases. *Load*: check, compile, make the endpoints, wait until the other ends that the collaboration promises are
there; the old process keeps running. *Start*, when all are ready: the old process is cancelled safely, the new one
begins. Otherwise *abort*, and every robot keeps what it had. A bare model from a plain publisher loads and starts at
once.

Each end is a pure state machine, ``(state, event) -> (state, actions)``, in a shell that does the input and output::

    robot_protocol     the robot's end: decisions        engine_node    its shell: a ROS 2 node
    robot_state        its data: state, events, actions
    termination        a robot whose sender is silent    loading        from a model to a process that is ready to run
    sender_protocol    the sender's end: decisions       sender         its shell
    leader_election    which splitter is the leader      splitter_node  its shell
    late_joiners       robots that join late or restart
    machine            runs a state machine: events in, actions out
    options            what an engine runs with, and a deployment is sent with
    resumption         the deployment on disk, for engines that resume; resumed_mission: loads it and lets it go on
    migration          plans of migrations, and their preview

    envelope           messages on bpmn_process and bpmn_status, their fields checked with `fields`
    signing            keys and signatures of messages; request_verifier: which messages an engine accepts
    authentication     which reports of a robot, and which diagrams for splitters, are accepted
    status             a robot's reports, with the warnings of its engine
  lifecycle          the engine as a lifecycle node of ROS
    requests           requests of people: complete a task, activate an element, abort a deployment
    assignment         which robot gets which part, which topics connect them, and where an error of a robot is
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.deploy.engine_node import EngineNode as EngineNode
    from fame.deploy.envelope import (
        STATUS_QOS as STATUS_QOS,
        STRING as STRING,
        Envelope as Envelope,
        Report as Report,
        engines as engines,
        model_hash as model_hash,
        read_envelope as read_envelope,
    )
    from fame.deploy.late_joiners import LateJoiners as LateJoiners
    from fame.deploy.sender import Deployment as Deployment
    from fame.deploy.sender_protocol import RobotProgress as RobotProgress
    from fame.deploy.splitter_node import SplitterNode as SplitterNode
else:
    __getattr__, __dir__, __all__ = attach(__name__)
