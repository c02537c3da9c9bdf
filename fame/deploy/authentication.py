"""Authentication of reports and diagrams.

Where keys are used, an engine signs its reports on ``bpmn_status`` with a key of its own: one that it makes when it
starts, or that of its identity (``fame keys robot``), for whose name a trusted key vouches: that proves the name. Of
engines that cannot prove their name the first one that reports is believed until it falls silent; a deployment then
vouches for it to the other robots.

Diagrams that go to splitters on ``/collaboration_diagram``, and between them, are signed as well.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Annotated, Any

from fame.dataclasses import dataclass
from fame.deploy import fields
from fame.deploy.envelope import SIZE, Report, model_hash, read_report
from fame.deploy.signing import FRESH, is_signed, is_vouched, verify_signature, with_signature
from fame.errors import DeploymentError
from fame.text import read_json
from fame.version import PROTOCOL

GONE = 3.0
"""After how long without a report of the engine that is believed another one takes its place (s)."""
RECENT = 10.0
"""How old a report may be that proves that another engine runs (s)."""


class ReportReader:
    """Reads what claims to be a report of one robot. Nothing here looks at a clock.

    signed    whether keys are used; then `trusted` are the public keys that vouch for names
    vouched   the `Report.engine` for which its deployment vouches: only that, and later ones with its key, are believed
    patience  how long the engine that is believed may be silent before another one takes its place (s)
    rival     whether another engine, no better proved, claims to be this robot; without keys: whether an older one
              was heard after a younger one, so that it has not been replaced
    strange   why the last text is no report, or nothing
    """

    def __init__(
        self,
        robot: str,
        *,
        signed: bool,
        trusted: Sequence[Any] = (),
        vouched: str = "",
        patience: float = math.inf,
    ) -> None:
        self.robot: str = robot
        self.signed: bool = signed
        self.trusted: Sequence[Any] = trusted
        self.vouched: str = vouched
        self.patience: float = patience
        self.rival: bool = False
        self.strange: str = ""
        self._key, self._proved = "", False
        self._last = (-1, -math.inf)  # `born` and `time` of the newest report: older ones may have been recorded
        self._received = 0.0
        self._youngest = 0  # `born` of what was read without keys

    @classmethod
    def of_sender(cls, robot: str, key: Any, patience: float = math.inf) -> ReportReader:
        """Return the reader of a sender that signs with `key`, or of one without keys if it is None."""
        return cls(robot, signed=key is not None, trusted=[] if key is None else [key.public_key()], patience=patience)

    def read(self, text: str, now: float = 0.0) -> Report | None:
        """Return the report that was received `now` (s), or None if its authentication fails."""
        try:
            report, self.strange = read_report(text), ""
        except DeploymentError as error:
            self.strange = str(error)
            return None
        if not self._is_vouched(report):
            return None
        if not self.signed:
            self.rival = self.rival or 0 < report.born < self._youngest
            self._youngest = max(self._youngest, report.born)
            return report
        if (
            report.robot != self.robot
            or not is_signed(report.received, report.key)
            or not self._is_believed(report, now)
        ):
            return None
        moment = (report.born, report.time)
        if moment < self._last:
            return None
        self._last, self._received = moment, now
        return report

    def _is_vouched(self, report: Report) -> bool:
        """Whether it is from the engine that was vouched for, or a later one with the same key."""
        born, _, key = self.vouched.partition(" ")
        return (
            report.engine == self.vouched or not self.vouched or (key == report.key != "" and report.born > int(born))
        )

    def _is_believed(self, report: Report, now: float) -> bool:
        """Whether it is from the engine that is believed, or from one that takes its place."""
        if report.key == self._key:
            return True
        proved = proves_name(report, self.robot, self.trusted)
        if self._key and proved <= self._proved and now - self._received <= self.patience:
            self.rival = self.rival or proved == self._proved
            return False
        self._key, self._proved, self._last, self.rival = report.key, proved, (-1, -math.inf), False
        return True


def proves_name(report: Report, robot: str, trusted: Sequence[Any]) -> bool:
    """Return whether a trusted key vouches that the key of a report is that of the robot."""
    return report.robot == robot and is_vouched(robot, report.key, report.voucher, trusted)


def proves_presence(report: Report, robot: str, trusted: Sequence[Any], now: float) -> bool:
    """Return whether a report proves that an engine of the robot runs `now` (s since 1970);
    without keys, every one does."""
    if not trusted:
        return True
    sent = report.born / 1e9 + report.time
    return abs(now - sent) <= RECENT and proves_name(report, robot, trusted) and is_signed(report.received, report.key)


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagram:
    """A model for splitters. `purpose`: ``deploy`` it, or ``deployed`` (what a splitter has deployed).

    `issued` is s since 1970. The signature is about all but the model, which its hash stands for.
    """

    model: Annotated[str, fields.text(SIZE)]
    hash: fields.Hash
    purpose: Annotated[str, fields.among("deploy", "deployed")]
    issued: fields.Number
    signature: fields.Name = ""

    @classmethod
    def of(cls, model: str, *, purpose: str, now: float, key: Any) -> Diagram:
        """Return a model signed with a private key."""
        diagram = cls(model=model, hash=model_hash(model.encode(errors="replace")), purpose=purpose, issued=now)
        return with_signature(diagram, key)

    def to_json(self) -> str:
        """Return the JSON text that is sent."""
        return json.dumps({"fame": PROTOCOL, **fields.values(self)}, sort_keys=True)


class DiagramReader:
    """Reads the diagrams that a splitter receives. With `trusted` keys it takes only what they signed, in order.

    What is to be deployed was signed after the splitter was `born` (s since 1970): it may have been recorded before.
    """

    def __init__(self, trusted: Sequence[Any], born: float = 0.0) -> None:
        self._trusted, self._born = trusted, born
        self._newest: dict[str, float] = {}  # purpose -> when what was taken last was signed

    def read(self, text: str, purpose: str, now: float) -> str:
        """Return the model of a diagram that was received `now` (s since 1970). Raises DeploymentError."""
        if not self._trusted:
            return text
        diagram = _read(text)
        verify_signature(fields.values(diagram), self._trusted)
        if diagram.purpose != purpose or model_hash(diagram.model.encode(errors="replace")) != diagram.hash:
            raise DeploymentError("the signature belongs to another message", cause="signature")
        if purpose == "deploy" and not abs(now - diagram.issued) <= FRESH:
            age = now - diagram.issued
            text = f"signed {age:.0f} s ago; at most {FRESH:g} s are accepted (are the clocks set?)"
            raise DeploymentError(text, cause="clock")
        if purpose == "deploy" and diagram.issued < self._born:
            text = "signed before this splitter began: it may be a replay; sign it again"
            raise DeploymentError(text, cause="replay")
        newest = self._newest.get(purpose, 0.0)
        if diagram.issued < newest or (purpose == "deploy" and diagram.issued == newest):
            raise DeploymentError("signed before the last accepted message: it may be a replay", cause="replay")
        self._newest[purpose] = diagram.issued
        return diagram.model


def _read(text: str) -> Diagram:
    try:
        values = read_json(text, SIZE)
        del values["fame"]
        return fields.read(Diagram, values)
    except (ValueError, TypeError, KeyError, AttributeError):
        raise DeploymentError(
            "not signed; this splitter accepts only diagrams signed with a trusted key", cause="signature"
        ) from None
