"""What goes between sender and robot: an `Envelope` there, a `Report` back, both as JSON in a std_msgs/msg/String."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

from fame.errors import DeploymentError
from fame.middleware.interface import QoS

STRING = "std_msgs/msg/String"
PROCESS_QOS = QoS(depth=20)
"""Of ``bpmn_process``: reliable and volatile, so that any publisher matches."""
STATUS_QOS = QoS(durability="transient_local", depth=100)
"""How a report is listened to: the last one of a robot that spoke before, and every one from then on."""
_SIZE = 20_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """What a robot is told. `promises`: public topics at which others have the opposite end, as ``publisher`` or
    ``subscriber``. `issued` (s since 1970) and `signature` are there where keys are used (`fame.signing`)."""

    deployment: str
    sequence: int
    robot: str
    phase: str
    hash: str = ""
    model: str = ""
    promises: Mapping[str, str] = field(default_factory=dict)
    issued: float = 0.0
    signature: str = ""

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps({"fame": 1, **asdict(self)}, sort_keys=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """How a robot stands, and what it answers to which deployment.

    state   ``waiting`` (for its first process), ``loading``, ``ready``, ``running``, ``idle`` (no instance), ``failed``
    instances, started, completed, failed      how many run now, have started, completed and failed with this process
    answer  ``ready``, ``started``, ``refused``, ``superseded``, ``aborted``, ``stale``; empty if it is no answer
    """

    robot: str
    state: str
    hash: str = ""
    deployment: str = ""
    answer: str = ""
    reason: str = ""
    instances: int = 0
    started: int = 0
    completed: int = 0
    failed: int = 0
    waits: Sequence[Mapping[str, str]] = ()
    error: str = ""
    time: float = 0.0

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Report | None:
        """A report, or None if the text is none."""
        try:
            return cls(**json.loads(text))
        except (ValueError, TypeError):
            return None


def model_hash(model: bytes) -> str:
    """What names a model."""
    return hashlib.sha256(model).hexdigest()


def read_envelope(text: str, robot: str) -> Envelope:
    """What came in: a bare model becomes an envelope of its own. Raises DeploymentError."""
    if len(text) > _SIZE:
        raise DeploymentError(f"{len(text)} characters; at most {_SIZE} are taken")
    if text.lstrip().startswith("<"):
        key = model_hash(text.encode())
        return Envelope(deployment=f"plain-{key[:12]}", sequence=-1, robot=robot, phase="run", hash=key, model=text)
    try:
        said = json.loads(text)
        said.pop("fame")
        envelope = Envelope(**said)
    except (ValueError, TypeError, KeyError, AttributeError):
        raise DeploymentError(f"neither a .bpmn text nor an envelope: {text[:60]!r}") from None
    if envelope.robot.casefold() != robot.casefold():
        raise DeploymentError(f"meant for robot {envelope.robot!r}, not for {robot!r}")
    if envelope.phase == "load" and model_hash(envelope.model.encode()) != envelope.hash:
        raise DeploymentError("the model does not have the hash that the envelope says")
    return envelope
