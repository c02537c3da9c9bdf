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

from fame.deploy.envelope import STATUS_QOS, STRING, Envelope, Report, engines, model_hash, read_envelope
from fame.lazy import from_homes

if TYPE_CHECKING:
    from fame.deploy.late_joiners import Keeper
    from fame.deploy.robot import EngineNode
    from fame.deploy.sender import Deployment, Standing
    from fame.deploy.splitter_node import SplitterNode

__all__ = [
    "STATUS_QOS",
    "STRING",
    "Deployment",
    "EngineNode",
    "Envelope",
    "Keeper",
    "Report",
    "SplitterNode",
    "Standing",
    "engines",
    "model_hash",
    "read_envelope",
]

_HOMES = {
    "Deployment": "sender",
    "EngineNode": "robot",
    "Keeper": "late_joiners",
    "SplitterNode": "splitter_node",
    "Standing": "sender",
}

__getattr__ = from_homes(__name__, _HOMES)
"""Either end is imported when it is first asked for: a robot needs nothing of the sender's."""
