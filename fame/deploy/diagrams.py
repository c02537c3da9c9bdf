"""Signed diagrams: what goes to splitters on ``/collaboration_diagram``, and between them, where keys are used."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from fame.deploy import fields
from fame.deploy.envelope import model_hash
from fame.deploy.signing import FRESH, sign, verify_signature
from fame.errors import DeploymentError


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagram:
    """The text of a model for splitters. `purpose`: ``deploy`` it, or ``deployed`` (what a splitter has deployed).

    `issued` is s since 1970. The signature is about all but the model, which its hash stands for.
    """

    model: str
    hash: str
    purpose: str
    issued: float
    signature: str = ""

    @classmethod
    def of(cls, model: str, *, purpose: str, now: float, key: Any) -> Diagram:
        """A model signed with a private key."""
        diagram = cls(model=model, hash=model_hash(model.encode(errors="replace")), purpose=purpose, issued=now)
        return replace(diagram, signature=sign(asdict(diagram), key))

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps({"fame": 1, **asdict(self)}, sort_keys=True)


_DIAGRAM: dict[str, fields.Check] = {
    "model": fields.text(20_000_000),
    "hash": fields.text(64),
    "purpose": fields.among("deploy", "deployed"),
    "issued": fields.number,
    "signature": fields.text(1000),
}


class DiagramReader:
    """Reads the diagrams that a splitter receives. With `trusted` keys it takes only what they signed, in order."""

    def __init__(self, trusted: Sequence[Any]) -> None:
        self._trusted = trusted
        self._newest: dict[str, float] = {}  # purpose -> when what was taken last was signed

    def read(self, text: str, purpose: str, now: float) -> str:
        """The model of a diagram that was received `now` (s since 1970). Raises DeploymentError."""
        if not self._trusted:
            return text
        diagram = _read(text)
        verify_signature(asdict(diagram), self._trusted)
        if diagram.purpose != purpose or model_hash(diagram.model.encode(errors="replace")) != diagram.hash:
            raise DeploymentError("the signature is about something else")
        if purpose == "deploy" and not abs(now - diagram.issued) <= FRESH:
            age = now - diagram.issued
            raise DeploymentError(f"signed {age:.0f} s ago; at most {FRESH:g} s are accepted (are the clocks set?)")
        newest = self._newest.get(purpose, 0.0)
        if diagram.issued < newest or (purpose == "deploy" and diagram.issued == newest):
            raise DeploymentError("signed before what was taken last: it may have been recorded")
        self._newest[purpose] = diagram.issued
        return diagram.model


def _read(text: str) -> Diagram:
    try:
        said = json.loads(text)
        del said["fame"]
        if fields.first_invalid(said, _DIAGRAM) is not None:
            raise TypeError
        return Diagram(**said)
    except (ValueError, TypeError, KeyError, RecursionError):
        raise DeploymentError("not signed; this splitter takes only what a trusted key signed") from None
