"""The messages between sender and robot: `Envelope` and `Report`, both as JSON in a std_msgs/msg/String."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fame.dataclasses import dataclass, field, replace
from fame.deploy import fields
from fame.errors import DeploymentError, FameError, ModelError
from fame.fast_json import json_bytes, json_value
from fame.middleware.interface import Middleware, QoS, known_topics
from fame.text import read_json
from fame.version import PROTOCOL, current, differs

STRING = "std_msgs/msg/String"
PROCESS_QOS = QoS(depth=20)
"""Of ``bpmn_process``: reliable and volatile, so that every reliable publisher matches."""
STATUS_QOS = QoS(durability="transient_local", depth=100)
"""Of subscriptions to ``bpmn_status``: the last report from before the match, and every one from then on."""
MATCHING = 5.0
"""How long a robot waits for the other ends of its topics, unless its sender says more or less (s)."""
SILENCE, LONGEST_SILENCE = 5.0, 3600.0
"""After how long without an envelope of its sender a robot that is ready asks the others, unless its sender says more,
and at most (s)."""
PHASES = ("load", "hold", "start", "abort", "ask")
"""Of an envelope that was sent; a bare model is one of phase ``run``."""
PLAIN = "plain-"
"""Prefix of the deployment id of a bare model, whose sender waits for no answer."""
SIZE, _LONGEST = 20_000_000, 1_000_000
"""The longest envelope or bare model, and the longest report, that is accepted (characters)."""
_SIGNATURE, _SHORT = 1_000, 1_000
"""Room for the signature of a report, and the longest text in one that is shortened (characters)."""
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
        """Return the place of an error of a model, None for any other one."""
        if not isinstance(error, ModelError):
            return None
        return cls(error.file, error.line, error.element, error.text, error.name)

    def __str__(self) -> str:
        return str(ModelError(self.text, file=self.file, line=self.line, element=self.element, name=self.name))


_Text = Annotated[str, fields.text(SIZE)]
_TEXT = fields.text(SIZE)
_WAIT: dict[str, fields.FieldCheck] = {
    **dict.fromkeys(("element", "for", "place", "suspended"), _TEXT),
    "since": fields.number,
    "topics": fields.mapping(_TEXT, fields.integer()),
}
_ERROR: dict[str, fields.FieldCheck] = {
    **dict.fromkeys(("code", "element", "name", "file", "text"), _TEXT),
    "line": fields.integer(),
}
_SUSPENDED: dict[str, fields.FieldCheck] = {**dict.fromkeys(("by", "holder"), _TEXT), "since": fields.number}
_PROBLEM = {name: check for name, check in _ERROR.items() if name != "code"}
_TOKEN: dict[str, fields.FieldCheck] = {
    **dict.fromkeys(("element", "fate", "target", "reason", "name"), _TEXT),
    "others": fields.sequence(_TEXT),
}
_TOKENS = fields.sequence(fields.record(_TOKEN))
_MIGRATION: dict[str, fields.FieldCheck] = {
    "hash": fields.text(64), "tokens": _TOKENS, "gone": _TOKENS, "state": fields.is_object,
}  # fmt: skip
_AT_WORK = ("running", "incident", "idle", "failed")
"""States in which the `error` of a `Report` is that of an instance."""
STATES = ("waiting", "loading", "ready", "holding", "running", "suspended", "incident", "idle", "failed")


def _is_proof(value: Any) -> bool:
    """Whether these are fields of an envelope that has no proof itself."""
    if not isinstance(value, dict) or value.get("proof", {}) != {}:
        return False
    rest = {name: each for name, each in value.items() if name != "proof"}
    return fields.first_invalid(rest, fields.checks(Envelope)) is None


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """What a sender, or another robot, tells a robot.

    phase     ``load`` (with the model), ``hold`` (go on waiting), ``start``, ``abort``; ``run`` of a bare model;
              ``ask``: another robot wants to know what became of the deployment
    begun     with ``start``: one of the team has started
    proof     with ``ask``, where keys are used: the signed envelope that the asking robot received, without the model
    promises  public topics at which others have the opposite end, as ``publisher`` or ``subscriber``
    matching  how long the robot waits for those ends (s)
    silence   after how long without an envelope of the sender it asks the others (s)
    team      the robots that start together with it
    engines   the `Report.engine` of each of them: reports of another engine are not believed
    receivers topics with acknowledgements that it throws: the other robots that catch them
    migrate   whether what runs goes over to the model, instead of being cancelled; `plan` as of
              `fame.deploy.migration`
    preview   whether it only asks what would become of the tokens: nothing is held, nothing started
    who       whose deployment it is: what keys prove counts more
    again     whether the robot had this process before, and lost it
    joins     whether it is for a robot that has no process yet: one that has one by then, or is promised one, refuses
    recalls   instead of a model, `promises` and `receivers`: the hash of those of a deployment that the robot keeps
              (`fame.deploy.history`)
    born      as in the `Report` of the engine that it is for: a recorded envelope is useless for a later engine
    issued    s since 1970; like `signature` only where keys are used (`fame.deploy.signing`)
    """

    deployment: fields.Name
    sequence: fields.Count
    robot: fields.RobotField
    phase: Annotated[str, fields.among(*PHASES)]
    hash: fields.Hash = ""
    model: _Text = ""
    promises: Annotated[Mapping[str, str], fields.mapping(fields.topic, fields.among("publisher", "subscriber"))] = (
        field(default_factory=dict, hash=False)
    )
    matching: fields.Number = MATCHING
    silence: Annotated[float, fields.seconds(LONGEST_SILENCE)] = SILENCE
    team: Annotated[Sequence[str], fields.sequence(fields.robot)] = field(default=(), hash=False)
    engines: Annotated[Mapping[str, str], fields.mapping(fields.robot, fields.text(1000))] = field(
        default_factory=dict, hash=False
    )
    receivers: Annotated[Mapping[str, Sequence[str]], fields.mapping(fields.topic, fields.sequence(fields.robot))] = (
        field(default_factory=dict, hash=False)
    )
    migrate: fields.FlagField = False
    plan: Annotated[Mapping[str, Any], fields.is_object] = field(default_factory=dict, hash=False)
    preview: fields.FlagField = False
    who: fields.Name = ""
    again: fields.FlagField = False
    begun: fields.FlagField = False
    recalls: fields.Hash = fields.later("")
    joins: fields.FlagField = fields.later(False)
    proof: Annotated[Mapping[str, Any], _is_proof] = field(default_factory=dict, hash=False)
    born: fields.Birth = 0
    issued: fields.Number = 0.0
    signature: fields.Name = ""

    @property
    def order(self) -> tuple[int, str]:
        """Of two envelopes the greater is the newer, for every robot that gets both."""
        return self.sequence, self.deployment

    def to_json(self) -> str:
        """Return the JSON text that is sent."""
        return json.dumps({"fame": PROTOCOL, **fields.values(self)}, sort_keys=True)


@dataclass(slots=True, kw_only=True)  # made for each robot each second: to make a frozen one takes three times as long
class Report:
    """The status of a robot, perhaps with an answer to a deployment.

    state   ``waiting`` (for its first process), ``loading``, ``ready``, ``holding`` (ready, its sender is
            silent), ``running``, ``suspended`` (by a person, or its
            state cannot be written), ``incident`` (holds until somebody repairs it), ``idle`` (no instance), ``failed``
            (no instance runs, and one of this process has failed)
    instances, started, completed, failed      of this process: how many run now, have started, completed, failed
    deployed   the deployment that its process came with, `hash` the model
    candidate  the deployment that is to replace it, while it is loading, ready or holding
    sequence   of the newest that it has loaded: the next one has to be above it, older ones are ``stale``
    answer     ``ready``, ``previewed``, ``started``, ``refused``, ``superseded``, ``aborted``, ``stale``, ``left`` (the
               engine ended), ``asking`` (the other robots what became of it),
               ``unknown`` (to one that asks), to `deployment`; or empty.
               On ``bpmn_task`` (`fame.deploy.requests`): what was done (``completed`` ...) or ``refused``
    problem    of a model that was refused: a `Problem`, which `reason` has in one sentence
    migration  with ``ready`` and ``previewed``: what becomes of its state (`fame.deploy.migration.Foreseen`); without
               an answer, what protocol 1 has no field for: see `said`
    elements   how many elements have been completed
    ahead      what timers of start events will still start: nothing, ``endless`` (cycles without end), ``due``
    waits      tokens that wait: `element`, `for` (in words), `since` (s), `topics` (each with the number of
               publishers), `place` (the drawn activity) and `suspended` (the cause and the time), if they differ
    more_waits number of waiting tokens beyond those
    untaken    how many messages no event has taken, by topic
    offers     the elements of open ad-hoc sub-processes that can be activated
    suspended  by which person its mission is suspended: `by`, `since` (s), `holder` (who steers it, or empty)
    incidents  elements that have failed and wait for somebody: `element`, `code`, `text`
    error      why it is suspended, or why the last of the instances that have failed did, whatever runs since
    errors     of the last instances that have failed: `code`, `element`, `name`, `file`, `line`, `text`
    warnings   of the middleware, of lost messages and of clocks that jump, the latest last
    absent     robots of its team that have no engine any more, and for how long (s)
    now        the time of the mission (s), as of `since`
    born       when the engine began (ns since 1970): of two with one name the older stays
    time       for how long it has been running (s)
    key        where keys are used, its public key; `voucher`: signature of a trusted key for its name
    received   as it came, which is what its signature is about; not sent
    """

    robot: fields.RobotField
    state: Annotated[str, fields.among(*STATES)]
    hash: fields.Hash = ""
    deployed: fields.Name = ""
    candidate: fields.Name = ""
    sequence: Annotated[int, fields.integer(-1)] = -1
    deployment: fields.Name = ""
    answer: fields.Name = ""
    reason: _Text = ""
    problem: Annotated[Mapping[str, Any], fields.record(_PROBLEM)] = field(default_factory=dict)
    migration: Annotated[Mapping[str, Any], fields.record(_MIGRATION)] = field(default_factory=dict)
    instances: fields.Count = 0
    started: fields.Count = 0
    completed: fields.Count = 0
    failed: fields.Count = 0
    elements: fields.Count = 0
    ahead: Annotated[str, fields.among("", "endless", "due")] = ""
    waits: Annotated[Sequence[Mapping[str, Any]], fields.sequence(fields.record(_WAIT))] = ()
    more_waits: fields.Count = 0
    untaken: Annotated[Mapping[str, int], fields.mapping(_TEXT, fields.integer())] = field(default_factory=dict)
    offers: Annotated[Sequence[str], fields.sequence(_TEXT)] = ()
    absent: Annotated[Mapping[str, float], fields.mapping(fields.robot, fields.number)] = field(default_factory=dict)
    warnings: Annotated[Sequence[str], fields.sequence(_TEXT)] = ()
    error: _Text = ""
    errors: Annotated[Sequence[Mapping[str, Any]], fields.sequence(fields.record(_ERROR))] = ()
    incidents: Annotated[
        Sequence[Mapping[str, str]], fields.sequence(fields.record(dict.fromkeys(("element", "code", "text"), _TEXT)))
    ] = ()
    suspended: Annotated[Mapping[str, Any], fields.record(_SUSPENDED)] = field(default_factory=dict)
    now: fields.Number = 0.0
    born: fields.Birth = 0
    time: fields.Number = 0.0
    key: fields.Name = ""
    voucher: fields.Name = ""
    signature: fields.Name = ""
    received: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @property
    def engine(self) -> str:
        """Identifies this run of this engine."""
        return f"{self.born} {self.key}"

    @property
    def said(self) -> Mapping[str, Any]:
        """What protocol 1 has no field for: `protocol`, `fame` (the version), `goals` (actions of which a cancelled
        goal may still run), `previous` (`fame.deploy.history.History.previous`).

        Protocol 1 drops a report with a field that it does not know, but for what is inside of `migration.state`.
        """
        return {} if self.deployment else self.migration.get("state", {})

    @property
    def protocol(self) -> int:
        return _protocol(self.said.get("protocol"))

    @property
    def differs(self) -> str:
        """What to say of a robot that speaks another protocol; nothing of an answer, which does not say which."""
        return "" if self.deployment else differs(self.robot, self.protocol, str(self.said.get("fame", ""))[:100])

    @property
    def goals(self) -> list[str]:
        """The actions of which a cancelled goal may still run."""
        goals = self.said.get("goals", ())
        return list(map(str, goals)) if isinstance(goals, list) else []

    @property
    def failures(self) -> str:
        """How many instances have failed, and why the last one, if others have started; else nothing."""
        if not self.failed or self.started < 2 or self.state not in _AT_WORK:
            return ""
        return ": ".join(filter(None, (f"{self.failed} of {self.started} instances failed", self.error)))

    def to_json(self, key: Any = None) -> str:
        """Return the JSON text that is sent, signed with a private key if one is given.

        If a script has failed with a text so long that the report would be refused, all texts are shortened.
        """
        content = fields.values(self)
        text = json_bytes(content)
        if len(text) > _LONGEST - _SIGNATURE:
            content = fields.shortened(content, _SHORT)
            text = json_bytes(content)
        if key is not None:
            from fame.deploy.signing import sign

            text = json_bytes({**content, "signature": sign(content, key)})
        return text.decode()

    @classmethod
    def from_json(cls, text: str) -> Report | None:
        """Return the report in a text, or None if it has none."""
        try:
            return read_report(text)
        except DeploymentError:
            return None


def read_report(text: str) -> Report:
    """Return the report in a text, without the fields that are unknown here. Raises DeploymentError."""
    content: Any = None
    try:
        content = read_json(text, _LONGEST, json_value)
        report = fields.read(Report, content, ignore=True)
    except (ValueError, TypeError) as error:
        raise DeploymentError(f"its status cannot be read ({error})", cause="syntax") from None
    report.received = content
    return report


def _protocol(number: Any) -> int:
    """The protocol of a message; 1 of one that has no number."""
    return number if type(number) is int and number > 0 else 1


def unreadable(what: str, text: str, found: Any, id: str, error: Exception) -> DeploymentError:
    """Return why a message, of which `found` was read, is refused. Its sender is told, by the name of the field and
    the protocols of both."""
    about, protocol = "", 1
    if isinstance(found, dict):
        protocol = _protocol(found.get("fame"))
        about = found[id] if fields.text(1000)(found.get(id)) else ""
    if protocol <= PROTOCOL:
        why = f" ({error})" if isinstance(error, TypeError | ValueError) else ""
        return DeploymentError(f"{what}{why}: {text[:60]!r}", cause="syntax", about=about)
    here = f"this robot runs FAME {current()} (protocol {PROTOCOL})"
    mend = "update it, or do without what the field is for"
    return DeploymentError(f"{error} of protocol {protocol} is unknown: {here}; {mend}", cause="protocol", about=about)


def model_hash(model: bytes) -> str:
    """Return the hash that identifies a model (SHA-256, hexadecimal)."""
    return hashlib.sha256(model).hexdigest()


def read_envelope(text: str, robot: str, now: float) -> Envelope:
    """Return the envelope that was received `now` (s since 1970); a bare model becomes one. Raises DeploymentError."""
    if len(text) > SIZE:
        raise DeploymentError(f"{len(text)} characters; at most {SIZE} are accepted", cause="size")
    text = text.removeprefix("\ufeff")  # byte order mark
    if text.lstrip().startswith("<"):
        key = _text_hash(text)
        return Envelope(deployment=f"{PLAIN}{key[:12]}", sequence=-1, robot=robot, phase="run", hash=key, model=text)
    content: Any = None
    try:
        content = read_json(text, SIZE)
        rest = {**content}
        del rest["fame"]
        envelope = fields.read(Envelope, rest)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise unreadable("neither a .bpmn text nor an envelope", text, content, "deployment", error) from None
    if envelope.robot.casefold() != robot.casefold():
        raise DeploymentError(f"meant for robot {envelope.robot!r}, not for {robot!r}", cause="robot")
    if is_ahead(envelope.sequence, now):
        ahead = (envelope.sequence / 1e6 - now) / 86_400
        raise DeploymentError(
            f"sequence {envelope.sequence} is {ahead:.0f} days ahead of this robot's clock; "
            f"at most {AHEAD / 86_400:.0f} are accepted (are the clocks set?)",
            cause="clock",
        )
    recalls = envelope.recalls and not envelope.model
    if envelope.phase == "load" and not recalls and _text_hash(envelope.model) != envelope.hash:
        raise DeploymentError("the hash of the model differs from that in the envelope", cause="hash")
    return envelope


def stored_envelope(text: str) -> Envelope:
    """Return an envelope that an engine has kept as JSON. Raises DeploymentError."""
    content: Any = None
    try:
        content = read_json(text, 2 * SIZE)  # escaped
        rest = {**content}
        del rest["fame"]
        if rest["phase"] != "run":
            return fields.read(Envelope, rest)
        bare = {**rest, "phase": "load", "sequence": 0}  # a bare model is no envelope that is sent
        return replace(fields.read(Envelope, bare), phase="run", sequence=-1)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise unreadable("is not a deployment that an engine has kept", text, content, "deployment", error) from None


def signed(envelope: Envelope, key: Any, *, born: int, now: float) -> Envelope:
    """Return an envelope signed `now` (s since 1970) for the engine that was `born` then; unchanged without a key."""
    from fame.deploy.signing import with_signature

    return envelope if key is None else with_signature(envelope, key, issued=now, born=born)


def is_ahead(sequence: int, now: float) -> bool:
    """Return whether a sequence is too far ahead of a clock (s since 1970)."""
    return sequence > (now + AHEAD) * 1e6


def _text_hash(text: str) -> str:
    try:
        return model_hash(text.encode())
    except UnicodeEncodeError:
        raise DeploymentError("the model has a lone surrogate: it is not valid Unicode", cause="syntax") from None


def engines(middleware: Middleware) -> list[str]:
    """Return the robots (namespaces) that have an engine."""
    suffix = "/bpmn_status"
    topics = known_topics(middleware, [f"/*{suffix}"], publishers=True)
    return [info.name[1 : -len(suffix)] for info in topics if info.name.endswith(suffix) and info.publishers]
