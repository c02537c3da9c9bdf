"""The splitter as a node: it takes whole collaborations on ``/collaboration_diagram`` and keeps the team supplied.

Its status is on ``/fame_splitter`` (latched, 1 Hz). There may be several splitters: all receive every diagram, one
leads (`fame.deploy.leader_election`), the others stand by. What it has deployed is on ``/fame_splitter/deployed``
(latched) as soon as robots were told to start. When another one takes the lead, the team goes on with what it has; only
a diagram that nobody had deployed yet is deployed then.

Of diagrams that wait, the newest is taken. One whose pools have no robots yet waits until they have.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import pools_of
from fame.bpmn.reader.xml import LIMIT
from fame.bpmn.split import split
from fame.clock import SECOND, Kind, Scheduler
from fame.deploy.authentication import Diagram, DiagramReader
from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, engines, model_hash
from fame.deploy.late_joiners import LateJoiners
from fame.deploy.leader_election import (
    HEARTBEAT,
    Beat,
    ElectionAction,
    ElectionEvent,
    ElectionState,
    Lead,
    SplitterStatus,
    SplitterStatusReceived,
    StandBy,
    Woken,
    step,
)
from fame.deploy.machine import ProtocolMachine, boundary
from fame.deploy.options import DeploymentOptions
from fame.deploy.sender import Deployment, Sender
from fame.deploy.sender_protocol import REFUSALS
from fame.deploy.status import RateLimiter
from fame.errors import ConfigError, DeploymentError, FameError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Middleware, Node

DIAGRAM, STATUS, DEPLOYED = "/collaboration_diagram", "/fame_splitter", "/fame_splitter/deployed"


class SplitterNode:
    """See the module. It deploys as `options` say; `log` gets a line for people.

    With `trusted` public keys only diagrams that one of them signed are taken.
    """

    def __init__(
        self,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        options: DeploymentOptions | None = None,
        trusted: Sequence[Any] = (),
        log: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.scheduler: Scheduler = scheduler
        self.middleware: Middleware = middleware
        self._options = options = options or DeploymentOptions()
        self._log = log
        self.born: int = round(options.wall_time() * SECOND)
        self._sender = Sender(f"splitter-{self.born}", scheduler, middleware, options)
        self._trusted, self._diagrams = trusted, DiagramReader(trusted, self.born / SECOND)
        election = ElectionState(self.born, beaten=scheduler.now)
        self._election: ProtocolMachine[ElectionState, ElectionEvent, ElectionAction] = ProtocolMachine(
            election, step, self._perform
        )
        self._diagram: tuple[str, Definitions] | None = None  # hash and model, the newest
        self._deployed = ""  # the hash of the diagram that the team has
        self._text = ""
        self._deployment: Deployment | None = None
        self._late_joiners: LateJoiners | None = None
        self._kept: tuple[tuple[str, Definitions], Collection[str]] | None = None  # what the team has, and who had it
        self.node: Node = middleware.node("fame_splitter")
        self._refused = RateLimiter(scheduler, self._report)

        def refuse(reason: str) -> None:
            self._refused(f"refused: {reason}", "error")

        self._status = self.node.publisher(STATUS, STRING, LATCHED)
        self.node.subscription(STATUS, STRING, boundary(self._on_status, refuse), STATUS_QOS)
        self._team = self.node.publisher(DEPLOYED, STRING, LATCHED)
        self.node.subscription(DEPLOYED, STRING, boundary(self._on_deployed, refuse), LATCHED)
        self.node.subscription(DIAGRAM, STRING, boundary(self._on_diagram, refuse), PROCESS_QOS).max_size = LIMIT
        self._pulse = scheduler.after(round(HEARTBEAT * SECOND), self._beat, Kind.TIMER)  # older splitters report first
        self._report("begins")

    @property
    def state(self) -> str:
        """``standby``, ``idle`` (no diagram), ``deploying``, ``keeping`` (the team has it)."""
        if not self._leads:
            return "standby"
        return "deploying" if self._deployment is not None else "idle" if self._late_joiners is None else "keeping"

    # ---- who leads -------------------------------------------------------------------------------------------------

    def _beat(self) -> None:
        led = self._leads
        self._election.handle(Beat(self.scheduler.now))
        if led and self._leads and self._deployment is None:
            self._try()
        self._publish()
        self._pulse = self.scheduler.after(round(HEARTBEAT * SECOND), self._beat, Kind.TIMER)

    @property
    def _leads(self) -> bool:
        return self._election.state.leads

    def _on_status(self, message: Any) -> None:
        status = SplitterStatus.from_json(message.data)
        if status is not None and status.is_believed(self._trusted, self._options.wall_time()):
            self._election.handle(SplitterStatusReceived(status, self.scheduler.now))

    def _perform(self, action: ElectionAction) -> None:
        match action:
            case Lead(inherited, gone):
                self._report("leads" + ("; the one before is gone" if gone else ""))
                self._take_over(inherited)
            case StandBy(reason):
                self._cease()
                if self._diagram is None and self._kept is not None:
                    self._diagram = self._kept[0]
                self._report(f"standby: {reason}")

    def _take_over(self, inherited: Collection[str]) -> None:
        """Keep the team of the leader before supplied; deploy what it had not deployed."""
        told = self._kept is not None and self._diagram is self._kept[0]
        if self._diagram is not None and (told or self._diagram[0] in inherited):
            self._keep(self._diagram, supplied=engines(self.middleware))
        else:
            self._try()

    # ---- diagrams --------------------------------------------------------------------------------------------------

    def _on_diagram(self, message: Any) -> None:
        try:
            diagram = self._read(message.data, "deploy")
        except FameError as error:
            cause = error.cause if isinstance(error, DeploymentError) else "model"
            self._refused(f"refused: {error}", cause)
            return
        self._diagram = diagram
        self._election.handle(Woken(self.scheduler.now))
        if self._leads and self._deployment is None:
            self._deployed = ""  # the same again is a restart
            self._try()

    def _on_deployed(self, message: Any) -> None:
        """Take note of what the leader has deployed."""
        self._election.handle(Woken(self.scheduler.now))
        if not self._leads:
            with suppress(FameError):
                diagram = self._read(message.data, "deployed")
                if self._kept is None or diagram[0] != self._kept[0][0]:  # else what was received since is newer
                    self._diagram, self._kept = diagram, (diagram, ())
                elif self._diagram is not None and self._diagram[0] == diagram[0]:
                    self._diagram = self._kept[0]
        elif self._diagram is None and self._kept is None:  # it leads until it has heard of the older
            with suppress(FameError):
                self._kept = self._read(message.data, "deployed"), ()

    def _read(self, text: str, purpose: str) -> tuple[str, Definitions]:
        """Hash and model, checked as far as that is possible without the robots. Raises FameError."""
        from fame.bpmn.reader import read_text
        from fame.check.gate import refuse_errors

        if len(text) > LIMIT:
            raise DeploymentError(f"{len(text)} characters; at most {LIMIT} are accepted", cause="size")
        text = self._diagrams.read(text, purpose, self._options.wall_time())
        definitions = read_text(text, file=DIAGRAM, sent=True)
        library = self._options.library or Library()
        refuse_errors(definitions, [pool.process for pool in pools_of(definitions)], library, sent=True)
        split(definitions, library)
        return model_hash(text.encode(errors="replace")), definitions

    def _try(self) -> None:
        """Deploy the newest diagram if the team does not have it yet and its robots are there."""
        if self._diagram is None or self._diagram[0] == self._deployed:
            return
        diagram = self._diagram
        try:
            ended, decided = partial(self._ended, diagram), partial(self._tell, diagram)
            self._deployment = self._sender.send(diagram[1], ended, decided=decided)
        except (ConfigError, DeploymentError) as error:
            self._report(f"waits: {error}")
        except FameError as error:
            self._diagram = None
            self._report(f"refused: {error}")
        else:
            self._cease(but=self._deployment)

    def _ended(self, diagram: tuple[str, Definitions], deployment: Deployment) -> None:
        robots = "; ".join(map(str, deployment.robots.values()))
        self._report(f"{'not deployed' if deployment.failed else 'deployed'}: {robots}")
        self.scheduler.soon(partial(self._after, diagram, deployment))

    def _after(self, diagram: tuple[str, Definitions], deployment: Deployment) -> None:
        """Keep the team supplied with what it has, and deploy what was received meanwhile."""
        deployment.close()
        if self._deployment is not deployment:
            return
        self._deployment = None
        refused = any(each.state in REFUSALS for each in deployment.robots.values())
        decided = self._kept is not None and self._kept[0] is diagram  # robots may have started that cannot be heard
        if deployment.started or (decided and not refused):  # a robot that has died meanwhile comes late
            self._keep(diagram, supplied=deployment.started)
        elif self._diagram is diagram and refused:
            self._diagram = None  # a robot that was silent may come back, and is asked again
            if self._kept is not None:
                self._keep(*self._kept)
        self._try()

    # ---- the team --------------------------------------------------------------------------------------------------

    def _keep(self, diagram: tuple[str, Definitions], supplied: Collection[str]) -> None:
        self._cease()
        self._deployed = diagram[0]
        self._tell(diagram, supplied)
        self._late_joiners = LateJoiners(diagram[1], self._sender, supplied=supplied, log=self._report)

    def _tell(self, diagram: tuple[str, Definitions], supplied: Collection[str] = ()) -> None:
        """Keep in mind what the team has, or will have, and tell the other splitters, which go on if this one dies."""
        self._kept = diagram, supplied
        model, key = diagram[1].source.decode(errors="replace"), self._options.key
        if key is not None:
            model = Diagram.of(model, purpose="deployed", now=self._options.wall_time(), key=key).to_json()
        self._team.publish(messages.create(STRING, model))

    def _cease(self, but: Deployment | None = None) -> None:
        """Stop deploying to late joiners, and abort the current deployment."""
        if self._late_joiners is not None:
            if self._kept is not None:
                self._kept = self._kept[0], self._late_joiners.supplied
            self._late_joiners.close()
        if self._deployment is not None and self._deployment is not but:
            self._deployment.close()
            self._deployment = None
        self._late_joiners = None

    # ---- status ----------------------------------------------------------------------------------------------------

    def _report(self, text: str) -> None:
        if text != self._text:
            self._text = text
            self._log(text)
        self._publish()

    def _publish(self) -> None:
        status = SplitterStatus(born=self.born, state=self.state, deployed=self._deployed, text=self._text)
        status = status.signed(self._options.key, self._options.wall_time())
        self._status.publish(messages.create(STRING, status.to_json()))

    def close(self) -> None:
        """Close all endpoints; the robots go on without it."""
        self._pulse.cancel()
        self._refused.close()
        self._cease()
        self.node.close()
