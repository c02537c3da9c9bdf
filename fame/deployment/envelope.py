"""What goes between sender and robot: an `Envelope` there, a `Report` back, both as JSON in a std_msgs/msg/String."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, TypeVar

from fame.errors import DeploymentError
from fame.middleware.interface import Middleware, QoS

STRING = "std_msgs/msg/String"
PROCESS_QOS = QoS(depth=20)
"""Of ``bpmn_process``: reliable and volatile, so that any publisher matches."""
STATUS_QOS = QoS(durability="transient_local", depth=100)
"""How a report is listened to: the last one of a robot that spoke before, and every one from then on."""
SILENCE = 5.0
"""After how long without a word from its sender a robot that is ready asks the others (s)."""
PHASES = ("load", "hold", "start", "abort")
"""Of an envelope that was sent; a bare model is one of phase ``run``."""
PLAIN = "plain-"
"""How the deployment of a bare model begins: nobody waits for an answer."""
_SIZE = 20_000_000
LAST = 2**53
"""A sequence is less: microseconds until the year 2255, and exact in the JSON of every language."""
_KINDS: dict[str, Any] = {
    "str": str,
    "int": int,
    "float": (int, float),
    "bool": bool,
    "Mapping": dict,
    "Sequence": list,
}
"""What an annotation is in JSON."""
_Said = TypeVar("_Said", "Envelope", "Report")


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """What a robot is told.

    phase     ``load`` (with the model), ``hold`` (go on waiting), ``start``, ``abort``; ``run`` of a bare model
    promises  public topics at which others have the opposite end, as ``publisher`` or ``subscriber``
    team      the robots that start together with it
    again     whether the robot had this process before, and lost it
    born      of the engine that it is for, as in its `Report`: what was recorded is no use once the engine began anew
    issued    s since 1970; like `signature` it is there where keys are used (`fame.signing`)
    """

    deployment: str
    sequence: int
    robot: str
    phase: str
    hash: str = ""
    model: str = ""
    promises: Mapping[str, str] = field(default_factory=dict)
    team: Sequence[str] = ()
    again: bool = False
    born: int = 0
    issued: float = 0.0
    signature: str = ""

    @property
    def order(self) -> tuple[int, str]:
        """Of two envelopes the greater is the newer, for every robot that gets both."""
        return self.sequence, self.deployment

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps({"fame": 1, **asdict(self)}, sort_keys=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """How a robot stands, and what it answers to which deployment.

    state   ``waiting`` (for its first process), ``loading``, ``ready``, ``running``, ``idle`` (no instance), ``failed``
    instances, started, completed, failed      how many run now, have started, completed and failed with this process
    deployed   the deployment that its process came with, `hash` the model
    sequence   of the newest that it has looked at: older ones are ``stale``, so the next one has to be above
    answer     ``ready``, ``started``, ``refused``, ``superseded``, ``aborted``, ``stale``, to `deployment`; or empty.
               On ``bpmn_task`` (`fame.deployment.tasks`): ``completed``, ``activated``, ``refused``, to that request
    waits      where tokens rest: `element`, `for` (in words), `since` (s), `topics` (with how many others publish)
    offers     the elements of open ad-hoc sub-processes that could be activated
    now        the time of the mission (s), which `since` is on
    born       when the engine began (ns since 1970): of two with one name the older stays
    time       how long it has been there (s)
    """

    robot: str
    state: str
    hash: str = ""
    deployed: str = ""
    sequence: int = -1
    deployment: str = ""
    answer: str = ""
    reason: str = ""
    instances: int = 0
    started: int = 0
    completed: int = 0
    failed: int = 0
    waits: Sequence[Mapping[str, Any]] = ()
    offers: Sequence[str] = ()
    error: str = ""
    now: float = 0.0
    born: int = 0
    time: float = 0.0

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Report | None:
        """A report, or None if the text is none."""
        try:
            report = _made(cls, json.loads(text))
            for wait in report.waits:
                _checked({"element": str, "for": str, "since": (int, float), "topics": dict}, wait)
            return report
        except (ValueError, TypeError, RecursionError):
            return None


def model_hash(model: bytes) -> str:
    """What names a model."""
    return hashlib.sha256(model).hexdigest()


def read_envelope(text: str, robot: str) -> Envelope:
    """What came in: a bare model becomes an envelope of its own. Raises DeploymentError."""
    if len(text) > _SIZE:
        raise DeploymentError(f"{len(text)} characters; at most {_SIZE} are taken")
    text = text.removeprefix("\ufeff")  # the mark that editors put before a file's text
    if text.lstrip().startswith("<"):
        key = _text_hash(text)
        return Envelope(deployment=f"{PLAIN}{key[:12]}", sequence=-1, robot=robot, phase="run", hash=key, model=text)
    try:
        said = json.loads(text)
        said.pop("fame")
        envelope = _made(Envelope, said)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise DeploymentError(f"neither a .bpmn text nor an envelope: {text[:60]!r}") from None
    if envelope.phase not in PHASES:
        raise DeploymentError(f"phase {envelope.phase!r}; there are {', '.join(PHASES)}")
    if envelope.robot.casefold() != robot.casefold():
        raise DeploymentError(f"meant for robot {envelope.robot!r}, not for {robot!r}")
    if not 0 <= envelope.sequence < LAST:
        raise DeploymentError(f"sequence {envelope.sequence}: 0 to {LAST - 1} would be right")
    if envelope.phase == "load" and _text_hash(envelope.model) != envelope.hash:
        raise DeploymentError("the model does not have the hash that the envelope says")
    return envelope


def _text_hash(text: str) -> str:
    try:
        return model_hash(text.encode())
    except UnicodeEncodeError:
        raise DeploymentError("the model has half a character (a lone surrogate)") from None


def _made(cls: type[_Said], said: Mapping[str, Any]) -> _Said:
    """An object of data that came from somewhere. Raises TypeError if a field is not what it has to be."""
    _checked({part.name: _KINDS[str(part.type).partition("[")[0]] for part in fields(cls)}, said)
    return cls(**said)


def _checked(kinds: Mapping[str, Any], said: Mapping[str, Any]) -> None:
    """Raises TypeError if one of the names that are there is not what it has to be."""
    if not isinstance(said, dict):
        raise TypeError("not an object")
    for name in kinds.keys() & said.keys():
        if not isinstance(said[name], kinds[name]) or (isinstance(said[name], bool) and kinds[name] is not bool):
            raise TypeError(name)


def engines(middleware: Middleware) -> list[str]:
    """The robots (namespaces) that have an engine."""
    suffix = "/bpmn_status"
    return [
        info.name[1 : -len(suffix)] for info in middleware.graph() if info.name.endswith(suffix) and info.publishers
    ]
