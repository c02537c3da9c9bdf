"""The messages between sender and robot: `Envelope` and `Report`, both as JSON in a std_msgs/msg/String."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from fame.deploy import fields
from fame.errors import DeploymentError, FameError, ModelError
from fame.middleware.interface import Middleware, QoS
from fame.text import read_json

STRING = "std_msgs/msg/String"
PROCESS_QOS = QoS(depth=20)
"""Of ``bpmn_process``: reliable and volatile, so that every reliable publisher matches."""
STATUS_QOS = QoS(durability="transient_local", depth=100)
"""Of subscriptions to ``bpmn_status``: the last report from before the match, and every one from then on."""
EVENTS_TOPIC, MODEL_TOPIC = "bpmn_events", "bpmn_model"
"""Topics of a robot on which it tells what happens in it (`fame.robot.live`)."""
SILENCE = 5.0
"""After how long without an envelope of its sender a robot that is ready asks the others (s)."""
PHASES = ("load", "hold", "start", "abort", "ask")
"""Of an envelope that was sent; a bare model is one of phase ``run``."""
PLAIN = "plain-"
"""Prefix of the deployment id of a bare model, whose sender waits for no answer."""
SIZE, _LONGEST = 20_000_000, 1_000_000
"""The longest envelope or bare model, and the longest report, that is accepted (characters)."""
_Message = TypeVar("_Message", "Envelope", "Report")
AHEAD = 366 * 86_400.0
"""How far a sequence may be ahead of the robot's clock (s). A sender takes a number above all that its robots have
seen: one from the far future would leave no numbers for later ones. The margin is for clocks that are wrong."""


@dataclass(frozen=True, slots=True)
class Problem:
    """The place of an error (``line`` from 1, 0 if unknown; id and ``name`` of an element), and its bare ``text``."""

    file: str = ""
    line: int = 0
    element: str = ""
    text: str = ""
    name: str = ""

    @classmethod
    def of(cls, error: FameError) -> Problem | None:
        """The place of an error of a model, None for any other one."""
        if not isinstance(error, ModelError):
            return None
        return cls(error.file, error.line, error.element, error.text, error.name)

    def __str__(self) -> str:
        return str(ModelError(self.text, file=self.file, line=self.line, element=self.element, name=self.name))


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """What a sender, or another robot, tells a robot.

    phase     ``load`` (with the model), ``hold`` (go on waiting), ``start``, ``abort``; ``run`` of a bare model;
              ``ask``: another robot wants to know what became of the deployment
    begun     with ``start``: one of the team has started
    proof     with ``ask``, where keys are used: the signed envelope that the asking robot received, without the model
    promises  public topics at which others have the opposite end, as ``publisher`` or ``subscriber``
    team      the robots that start together with it
    engines   the `Report.engine` of each of them: reports of another engine are not believed
    migrate   whether what runs goes over to the model, instead of being cancelled; `plan` as of
              `fame.deploy.migration`
    preview   whether it only asks what would become of the tokens: nothing is held, nothing started
    who       whose deployment it is: what keys prove counts more
    again     whether the robot had this process before, and lost it
    born      as in the `Report` of the engine that it is for: a recorded envelope is useless for a later engine
    issued    s since 1970; like `signature` only where keys are used (`fame.deploy.signing`)
    """

    deployment: str
    sequence: int
    robot: str
    phase: str
    hash: str = ""
    model: str = ""
    promises: Mapping[str, str] = field(default_factory=dict, hash=False)
    team: Sequence[str] = field(default=(), hash=False)
    engines: Mapping[str, str] = field(default_factory=dict, hash=False)
    migrate: bool = False
    plan: Mapping[str, Any] = field(default_factory=dict, hash=False)
    preview: bool = False
    who: str = ""
    again: bool = False
    begun: bool = False
    proof: Mapping[str, Any] = field(default_factory=dict, hash=False)
    born: int = 0
    issued: float = 0.0
    signature: str = ""

    @property
    def order(self) -> tuple[int, str]:
        """Of two envelopes the greater is the newer, for every robot that gets both."""
        return self.sequence, self.deployment

    def to_json(self) -> str:
        """The JSON text that is sent."""
        return json.dumps({"fame": 1, **fields.values(self)}, sort_keys=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The status of a robot, perhaps with an answer to a deployment.

    state   ``waiting`` (for its first process), ``loading``, ``ready``, ``holding`` (ready, its sender is
            silent), ``running``, ``suspended`` (its
            state cannot be written), ``incident`` (holds until somebody repairs it), ``idle`` (no instance), ``failed``
    instances, started, completed, failed      of this process: how many run now, have started, completed, failed
    deployed   the deployment that its process came with, `hash` the model
    candidate  the deployment that is to replace it, while it is loading, ready or holding
    sequence   of the newest that it has loaded: the next one has to be above it, older ones are ``stale``
    answer     ``ready``, ``previewed``, ``started``, ``refused``, ``superseded``, ``aborted``, ``stale``, ``left`` (the
               engine ended), ``asking`` (the other robots what became of it),
               ``unknown`` (to one that asks), to `deployment`; or empty.
               On ``bpmn_task`` (`fame.deploy.requests`): what was done (``completed`` ...) or ``refused``
    problem    of a model that was refused: a `Problem`, which `reason` has in one sentence
    migration  with ``ready`` and ``previewed``: what becomes of its state (`fame.deploy.migration.Foreseen`)
    elements   how many elements have been completed
    ahead      what timers of start events will still start: nothing, ``endless`` (cycles without end), ``due``
    waits      tokens that wait: `element`, `for` (in words), `since` (s), `topics` (each with the number of
               publishers), `place` (the drawn activity) and `suspended` (the cause and the time), if they differ
    more_waits number of waiting tokens beyond those
    untaken    how many messages no event has taken, by topic
    offers     the elements of open ad-hoc sub-processes that can be activated
    incidents  elements that have failed and wait for somebody: `element`, `code`, `text`
    errors     of the last instances that have failed: `code`, `element`, `name`, `file`, `line`, `text`
    warnings   of the middleware, of lost messages and of clocks that jump, the latest last
    absent     robots of its team that have no engine any more, and for how long (s)
    now        the time of the mission (s), as of `since`
    born       when the engine began (ns since 1970): of two with one name the older stays
    time       for how long it has been running (s)
    key        where keys are used, its public key; `voucher`: signature of a trusted key for its name
    """

    robot: str
    state: str
    hash: str = ""
    deployed: str = ""
    candidate: str = ""
    sequence: int = -1
    deployment: str = ""
    answer: str = ""
    reason: str = ""
    problem: Mapping[str, Any] = field(default_factory=dict)
    migration: Mapping[str, Any] = field(default_factory=dict)
    instances: int = 0
    started: int = 0
    completed: int = 0
    failed: int = 0
    elements: int = 0
    ahead: str = ""
    waits: Sequence[Mapping[str, Any]] = ()
    more_waits: int = 0
    untaken: Mapping[str, int] = field(default_factory=dict)
    offers: Sequence[str] = ()
    absent: Mapping[str, float] = field(default_factory=dict)
    warnings: Sequence[str] = ()
    error: str = ""
    errors: Sequence[Mapping[str, Any]] = ()
    incidents: Sequence[Mapping[str, str]] = ()
    now: float = 0.0
    born: int = 0
    time: float = 0.0
    key: str = ""
    voucher: str = ""
    signature: str = ""

    @property
    def engine(self) -> str:
        """Identifies this run of this engine."""
        return f"{self.born} {self.key}"

    def to_json(self) -> str:
        """The JSON text that is sent."""
        return json.dumps(fields.values(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Report | None:
        """The report in a text, or None if it has none."""
        try:
            return _message(cls, read_json(text, _LONGEST), _REPORT)
        except (ValueError, TypeError):
            return None


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


_TEXT, _NAME = fields.text(SIZE), fields.text(1000)
_ENVELOPE: dict[str, fields._Check] = {
    "deployment": _NAME,
    "sequence": fields.integer(),
    "robot": fields.robot,
    "phase": fields.among(*PHASES),
    "hash": fields.text(64),
    "model": _TEXT,
    "promises": fields.mapping(fields.topic, fields.among("publisher", "subscriber")),
    "team": fields.sequence(fields.robot),
    "engines": fields.mapping(fields.robot, _NAME),
    "migrate": fields.flag,
    "plan": _is_object,
    "preview": fields.flag,
    "who": _NAME,
    "again": fields.flag,
    "begun": fields.flag,
    "born": fields.integer(0, 2**63),
    "issued": fields.number,
    "signature": _NAME,
}
_ENVELOPE["proof"] = fields.record({**_ENVELOPE, "proof": fields.record({})})
_WAIT: dict[str, fields._Check] = {
    "element": _TEXT,
    "for": _TEXT,
    "since": fields.number,
    "topics": fields.mapping(_TEXT, fields.integer()),
    "place": _TEXT,
    "suspended": _TEXT,
}
_ERROR: dict[str, fields._Check] = {
    **dict.fromkeys(("code", "element", "name", "file", "text"), _TEXT),
    "line": fields.integer(),
}
_TOKEN: dict[str, fields._Check] = {
    **dict.fromkeys(("element", "fate", "target", "reason", "name"), _TEXT),
    "others": fields.sequence(_TEXT),
}
_PROBLEM = {name: check for name, check in _ERROR.items() if name != "code"}
STATES = ("waiting", "loading", "ready", "holding", "running", "suspended", "incident", "idle", "failed")
_REPORT: dict[str, fields._Check] = {
    "robot": fields.robot,
    "state": fields.among(
        "waiting", "loading", "ready", "holding", "running", "suspended", "incident", "idle", "failed"
    ),
    "hash": fields.text(64),
    "deployed": _NAME,
    "candidate": _NAME,
    "sequence": fields.integer(-1),
    "deployment": _NAME,
    "answer": _NAME,
    "reason": _TEXT,
    "problem": fields.record(_PROBLEM),
    "migration": fields.record(
        {
            "hash": fields.text(64),
            "tokens": fields.sequence(fields.record(_TOKEN)),
            "gone": fields.sequence(fields.record(_TOKEN)),
            "state": _is_object,
        }
    ),
    "instances": fields.integer(),
    "started": fields.integer(),
    "elements": fields.integer(),
    "ahead": fields.among("", "endless", "due"),
    "errors": fields.sequence(fields.record(_ERROR)),
    "incidents": fields.sequence(fields.record({"element": _TEXT, "code": _TEXT, "text": _TEXT})),
    "completed": fields.integer(),
    "failed": fields.integer(),
    "waits": fields.sequence(fields.record(_WAIT)),
    "more_waits": fields.integer(),
    "untaken": fields.mapping(_TEXT, fields.integer()),
    "offers": fields.sequence(_TEXT),
    "warnings": fields.sequence(_TEXT),
    "absent": fields.mapping(fields.robot, fields.number),
    "error": _TEXT,
    "now": fields.number,
    "born": fields.integer(0, 2**63),
    "time": fields.number,
    "key": _NAME,
    "voucher": _NAME,
    "signature": _NAME,
}


def model_hash(model: bytes) -> str:
    """The hash that identifies a model (SHA-256, hexadecimal)."""
    return hashlib.sha256(model).hexdigest()


def read_envelope(text: str, robot: str, now: float) -> Envelope:
    """The envelope that was received `now` (s since 1970); a bare model becomes one. Raises DeploymentError."""
    if len(text) > SIZE:
        raise DeploymentError(f"{len(text)} characters; at most {SIZE} are accepted", cause="size")
    text = text.removeprefix("\ufeff")  # byte order mark
    if text.lstrip().startswith("<"):
        key = _text_hash(text)
        return Envelope(deployment=f"{PLAIN}{key[:12]}", sequence=-1, robot=robot, phase="run", hash=key, model=text)
    try:
        found = read_json(text, SIZE)
        found.pop("fame")
        envelope = _message(Envelope, found, _ENVELOPE)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        why = f" ({error})" if isinstance(error, TypeError | ValueError) else ""
        raise DeploymentError(f"neither a .bpmn text nor an envelope{why}: {text[:60]!r}", cause="syntax") from None
    if envelope.robot.casefold() != robot.casefold():
        raise DeploymentError(f"meant for robot {envelope.robot!r}, not for {robot!r}", cause="robot")
    if is_ahead(envelope.sequence, now):
        ahead = (envelope.sequence / 1e6 - now) / 86_400
        raise DeploymentError(
            f"sequence {envelope.sequence} is {ahead:.0f} days ahead of this robot's clock; "
            f"at most {AHEAD / 86_400:.0f} are accepted (are the clocks set?)",
            cause="clock",
        )
    if envelope.phase == "load" and _text_hash(envelope.model) != envelope.hash:
        raise DeploymentError("the hash of the model differs from that in the envelope", cause="hash")
    return envelope


def stored_envelope(text: str) -> Envelope:
    """An envelope that an engine has kept as JSON. Raises DeploymentError."""
    try:
        found = read_json(text, 2 * SIZE)  # escaped
        found.pop("fame")
        if found["phase"] != "run":
            return _message(Envelope, found, _ENVELOPE)
        bare = {**found, "phase": "load", "sequence": 0}  # a bare model is no envelope that is sent
        return replace(_message(Envelope, bare, _ENVELOPE), phase="run", sequence=-1)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise DeploymentError(f"is not a deployment that an engine has kept: {error}", cause="syntax") from None


def signed(envelope: Envelope, key: Any, *, born: int, now: float) -> Envelope:
    """An envelope signed `now` (s since 1970) for the engine that was `born` then; unchanged without a key."""
    from fame.deploy.signing import sign

    if key is None:
        return envelope
    envelope = replace(envelope, issued=now, born=born)
    return replace(envelope, signature=sign(fields.values(envelope), key))


def is_ahead(sequence: int, now: float) -> bool:
    """Whether a sequence is too far ahead of a clock (s since 1970)."""
    return sequence > (now + AHEAD) * 1e6


def _text_hash(text: str) -> str:
    try:
        return model_hash(text.encode())
    except UnicodeEncodeError:
        raise DeploymentError("the model has a lone surrogate: it is not valid Unicode", cause="syntax") from None


def _message(cls: type[_Message], found: Any, checks: Mapping[str, fields._Check]) -> _Message:
    """A message made of JSON. Raises TypeError for a field that is unknown or has a wrong value."""
    if not isinstance(found, dict):
        raise TypeError("not an object")
    field = fields.first_invalid(found, checks)
    if field is not None:
        raise TypeError(f"field {field[:40]!r}")
    return cls(**found)


def engines(middleware: Middleware) -> list[str]:
    """The robots (namespaces) that have an engine."""
    suffix = "/bpmn_status"
    return [
        info.name[1 : -len(suffix)] for info in middleware.graph() if info.name.endswith(suffix) and info.publishers
    ]
