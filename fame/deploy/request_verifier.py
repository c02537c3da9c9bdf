"""Verification of what an engine is asked for: deployments, requests on its tasks, recordings; and of its namesakes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fame.deploy import fields
from fame.deploy.authentication import proves_presence
from fame.deploy.envelope import Envelope, Report
from fame.deploy.requests import SignedRequest, TaskRequest
from fame.deploy.signing import signer, verify, verify_signature
from fame.errors import DeploymentError
from fame.text import printable


class RequestVerifier:
    """Verifies the signatures of requests to the engine of `robot`, which started at `born` (ns since 1970).

    trusted         public keys; without any, nothing need be signed
    unsigned_tasks  requests on tasks need not be signed; all others must be
    wall_time       gives s since 1970
    """

    def __init__(
        self,
        robot: str,
        born: int,
        trusted: Sequence[Any],
        wall_time: Callable[[], float],
        *,
        unsigned_tasks: bool = False,
    ) -> None:
        self.robot: str = robot
        self.born: int = born
        self._trusted, self._wall_time, self._unsigned_tasks = trusted, wall_time, unsigned_tasks

    def verify_deployment(self, envelope: Envelope) -> None:
        """Raise DeploymentError unless a trusted key signed it; another robot asks with what its own sender signed."""
        if not self._trusted:
            return
        if envelope.phase != "ask":
            verify(fields.values(envelope), self._trusted, self._wall_time(), self.born)
            return
        verify_signature(envelope.proof, self._trusted)
        if (envelope.proof.get("deployment"), envelope.proof.get("sequence")) != (
            envelope.deployment,
            envelope.sequence,
        ):
            raise DeploymentError("asks about another deployment than the signed one", cause="signature")

    def verify_task(self, request: TaskRequest) -> str:
        """Return the fingerprint of the key that signed a request; empty for one that counts as unsigned.

        Raises DeploymentError if keys are used and it was not signed for this robot, unless it need not be signed.
        """
        try:
            self.verify_request(request)
        except DeploymentError:
            if self._unsigned_tasks:
                return ""  # anybody may replay a signature, or sign with another key
            raise
        return self._signer(request)

    def verify_request(self, request: SignedRequest) -> None:
        """Raise DeploymentError if keys are used and a request was not signed, not long ago, for this robot."""
        if self._trusted:
            verify(fields.values(request), self._trusted, self._wall_time(), self.born)
            if request.robot != self.robot:
                raise DeploymentError(f"meant for robot {request.robot!r}, not for {self.robot!r}", cause="robot")

    def proves_presence(self, report: Report) -> bool:
        """Return whether a report proves that an engine of the robot runs now; without keys, every one does."""
        return proves_presence(report, self.robot, self._trusted, self._wall_time())

    def sender(self, envelope: Envelope) -> str:
        """Return who sent a deployment, for people: the fingerprint of the key, or the name that the sender gave."""
        return self._signer(envelope) or f"{printable(envelope.who) or 'unknown'} (unverified)"

    def _signer(self, message: Envelope | TaskRequest) -> str:
        return signer(fields.values(message), self._trusted) if message.signature and self._trusted else ""
