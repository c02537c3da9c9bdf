"""Sending robots their processes, over topics (DESIGN section 6).

An `EngineNode` is a robot's end: it waits on ``/<robot>/bpmn_process``, and says how it stands on
``/<robot>/bpmn_status``. A `Deployment` is the other end: it sends every robot its part, waits for each, and starts
all or none.

Two phases. *Load*: check, compile, make endpoints, wait until the ends that the collaboration promises are there; the
old process runs on. *Start*, when all are ready: the old process is cancelled safely, the new one begins. Otherwise
*abort*, and everybody keeps what it had. A bare model from a plain publisher loads and starts at once.

::

    envelope   what goes over ``bpmn_process`` and ``bpmn_status``
    robot      the robot's end
    candidate  a process that is to take the place of what runs
    reporting  what a robot says of itself
    loading    from a model that was sent to a process that is ready
    warming    what an engine loads while it waits for its first process
    termination  what a robot that is ready does when its sender falls silent
    inquiry    asking the other robots for that
    sender     the sender's end
    origins    where in the sender's files is what robots tell of theirs
    casting    who gets which part, and who promises whom which topics
    keeping    robots that come late, or come back
    splitting  the splitter as a node
    role       which of several splitters has the role
    aborting   a person aborts what a robot holds
    tasks      what people do on a running robot: complete tasks, activate elements of ad-hoc sub-processes
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import attach

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
    from fame.deploy.late_joiners import Keeper as Keeper
    from fame.deploy.sender import Deployment as Deployment
    from fame.deploy.sender_protocol import RobotProgress as RobotProgress
    from fame.deploy.splitter_node import SplitterNode as SplitterNode
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "envelope": ["Envelope", "Report", "STATUS_QOS", "STRING", "engines", "model_hash", "read_envelope"],
            "late_joiners": ["Keeper"],
            "engine_node": ["EngineNode"],
            "sender": ["Deployment"],
            "sender_protocol": ["RobotProgress"],
            "splitter_node": ["SplitterNode"],
        },
    )
