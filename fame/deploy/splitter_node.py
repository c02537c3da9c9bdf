"""The splitter as a node: it takes whole collaborations on ``/collaboration_diagram`` and keeps the team supplied.

What it is at stands on ``/fame_splitter`` (latched, 1 Hz). There may be several splitters: all hear every diagram, the
oldest that is heard has the role, the others stand by. What it has deployed stands on ``/fame_splitter/deployed``, for
those who come later. Where the role changes hands, the team goes on with what it has; only a diagram that nobody had
deployed yet is deployed then.

Of diagrams that wait, the newest is taken. One whose pools have no robots yet waits until they have.
"""

from __future__ import annotations

import time
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
from fame.deploy.diagrams import Desk, Diagram
from fame.deploy.envelope import PROCESS_QOS, STATUS_QOS, STRING, engines, model_hash
from fame.deploy.late_joiners import Keeper
from fame.deploy.leader_election import GONE, HEARTBEAT, Others, Role
from fame.deploy.sender import PATIENCE, Deployment
from fame.deploy.sender_protocol import REFUSALS
from fame.deploy.warnings import RateLimiter
from fame.errors import ConfigError, DeploymentError, FameError
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Middleware

DIAGRAM, STATUS, DEPLOYED = "/collaboration_diagram", "/fame_splitter", "/fame_splitter/deployed"


class SplitterNode:
    """See the module. `say` gets a line for people; `patience` is how long a robot may take to answer (s).

    `key` signs what is sent. With `trusted` public keys only diagrams that one of them signed are taken.
    """

    def __init__(
        self,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        library: Library | None = None,
        patience: float = PATIENCE,
        key: Any = None,
        trusted: Sequence[Any] = (),
        say: Callable[[str], object] = lambda text: None,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self.scheduler, self.middleware, self._say, self._wall_time = scheduler, middleware, say, wall_time
        self._options: dict[str, Any] = {
            "library": library or Library(),
            "patience": patience,
            "key": key,
            "wall_time": wall_time,
        }
        self.born = round(wall_time() * SECOND)
        self._desk = Desk(trusted)
        self._sequence = 0
        self._others = Others(self.born, scheduler, trusted=trusted, wall_time=wall_time)
        self._beaten = scheduler.now
        self._diagram: tuple[str, Definitions] | None = None  # hash and model, the newest
        self._deployed = ""  # the hash of the diagram that the team has
        self._text = ""
        self._deployment: Deployment | None = None
        self._keeper: Keeper | None = None
        self.node = middleware.node("fame_splitter")
        self._status = self.node.publisher(STATUS, STRING, LATCHED)
        self.node.subscription(STATUS, STRING, lambda message: self._others.heard(message.data), STATUS_QOS)
        self._team = self.node.publisher(DEPLOYED, STRING, LATCHED)
        self.node.subscription(DEPLOYED, STRING, self._inherit, LATCHED)
        self.node.subscription(DIAGRAM, STRING, self._heard, PROCESS_QOS).max_size = LIMIT
        self._leads = False
        self._refused = RateLimiter(scheduler, self._report)
        self._pulse = scheduler.after(round(HEARTBEAT * SECOND), self._beat, Kind.TIMER)  # elders speak first
        self._report("begins")

    @property
    def state(self) -> str:
        """``standby``, ``idle`` (no diagram), ``deploying``, ``keeping`` (the team has it)."""
        if not self._leads:
            return "standby"
        return "deploying" if self._deployment is not None else "keeping" if self._keeper is not None else "idle"

    # ---- who has the role ------------------------------------------------------------------------------------------

    def _beat(self) -> None:
        heirloom = self._others.forget_silent()
        self._step_down_if_away()
        if self._leads and self._others.older:
            self._step_down("there is an older splitter")
        elif not self._leads and not self._others.older and not self._away:
            self._leads = True
            self._report("has the role" + ("; the one before is gone" if heirloom else ""))
            self._take_over([*heirloom, self._others.regent])
        elif self._leads and self._deployment is None:
            self._try()
        self._publish()
        self._beaten = self.scheduler.now
        self._pulse = self.scheduler.after(round(HEARTBEAT * SECOND), self._beat, Kind.TIMER)

    @property
    def _away(self) -> bool:
        """Whether it was stopped for so long that another one may have taken the role."""
        return self.scheduler.now - self._beaten > GONE * SECOND

    def _step_down_if_away(self) -> None:
        if self._leads and (self._away or self._others.regent):
            self._step_down("it was stopped or cut off, and listens what became of the team")

    def _step_down(self, reason: str) -> None:
        self._leads = False
        self._let_be()
        self._report(f"stands by: {reason}")

    def _take_over(self, heirloom: Sequence[str]) -> None:
        """The team of the one before is kept; what it had not deployed is deployed."""
        self._others.regent = ""
        if self._diagram is not None and self._diagram[0] in heirloom:
            self._keep(self._diagram, served=engines(self.middleware))
        else:
            self._try()

    # ---- diagrams --------------------------------------------------------------------------------------------------

    def _heard(self, message: Any) -> None:
        try:
            diagram = self._read(message.data, "deploy")
        except FameError as error:
            self._refused(f"refused: {error}")
            return
        self._diagram = diagram
        self._step_down_if_away()
        if self._leads and self._deployment is None:
            self._deployed = ""  # the same again is a restart
            self._try()

    def _inherit(self, message: Any) -> None:
        """What the one that has the role has deployed."""
        self._step_down_if_away()
        if not self._leads:
            with suppress(FameError):
                self._diagram = self._read(message.data, "deployed")

    def _read(self, text: str, purpose: str) -> tuple[str, Definitions]:
        """Check it as far as it can be without the robots. Raises FameError."""
        from fame.bpmn.reader import read_text
        from fame.check.gate import refuse_errors

        if len(text) > LIMIT:
            raise DeploymentError(f"{len(text)} characters; at most {LIMIT} are taken")
        text = self._desk.take(text, purpose, self._wall_time())
        definitions = read_text(text, file=DIAGRAM)
        library = self._options["library"]
        refuse_errors(definitions, [pool.process for pool in pools_of(definitions)], library, sent=True)
        split(definitions, library)
        return model_hash(text.encode(errors="replace")), definitions

    def _try(self) -> None:
        """Deploy the newest diagram, if the team has it not and its robots are there."""
        if self._diagram is None or self._diagram[0] == self._deployed:
            return
        diagram = self._diagram
        try:
            self._deployment = self._send(diagram[1], (), (), partial(self._ended, diagram))
        except (ConfigError, DeploymentError) as error:
            self._report(f"waits: {error}")
        except FameError as error:
            self._diagram = None
            self._report(f"refused: {error}")
        else:
            self._let_be(but=self._deployment)

    def _send(
        self,
        definitions: Definitions,
        only: Sequence[str],
        again: Collection[str],
        ended: Callable[[Deployment], object],
    ) -> Deployment:
        self._sequence = max(self._sequence + 1, round(self._wall_time() * 1e6))
        deployment = Deployment(
            definitions,
            id=f"splitter-{self.born}-{self._sequence}",
            sequence=self._sequence,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=ended,
            only=only,
            again=again,
            **self._options,
        )
        deployment.begin()
        return deployment

    def _ended(self, diagram: tuple[str, Definitions], deployment: Deployment) -> None:
        robots = "; ".join(map(str, deployment.robots.values()))
        self._report(f"{'not deployed' if deployment.failed else 'deployed'}: {robots}")
        self.scheduler.soon(partial(self._after, diagram, deployment))

    def _after(self, diagram: tuple[str, Definitions], deployment: Deployment) -> None:
        """Make room for what came meanwhile, or keep the team supplied with what it has."""
        deployment.close()
        if self._deployment is not deployment:
            return
        self._deployment = None
        if not deployment.failed:
            self._keep(diagram, served=deployment.robots)
        elif self._diagram is diagram and any(each.state in REFUSALS for each in deployment.robots.values()):
            self._diagram = None  # the team keeps what it had; who was silent may come back, and is asked again
        self._try()

    # ---- the team --------------------------------------------------------------------------------------------------

    def _keep(self, diagram: tuple[str, Definitions], served: Collection[str]) -> None:
        self._let_be()
        self._deployed = diagram[0]
        self._team.publish(messages.create(STRING, self._deployed_text(diagram[1].source.decode(errors="replace"))))
        send = partial(self._send, diagram[1])
        around: dict[str, Any] = {"scheduler": self.scheduler, "middleware": self.middleware}
        self._keeper = Keeper(diagram[1], send, key=self._options["key"], served=served, say=self._report, **around)

    def _deployed_text(self, model: str) -> str:
        """What others are told that the team has."""
        key = self._options["key"]
        if key is None:
            return model
        return Diagram.of(model, purpose="deployed", now=self._wall_time(), key=key).to_json()

    def _let_be(self, but: Deployment | None = None) -> None:
        """Work no more for anybody."""
        if self._keeper is not None:
            self._keeper.close()
        if self._deployment is not None and self._deployment is not but:
            self._deployment.close()
            self._deployment = None
        self._keeper = None

    # ---- saying so -------------------------------------------------------------------------------------------------

    def _report(self, text: str) -> None:
        if text != self._text:
            self._text = text
            self._say(text)
        self._publish()

    def _publish(self) -> None:
        role = Role(born=self.born, state=self.state, deployed=self._deployed, text=self._text)
        role = role.signed(self._options["key"], self._wall_time())
        self._status.publish(messages.create(STRING, role.to_json()))

    def stop(self) -> bool:
        """It is over at once: the robots go on without it."""
        return False

    def close(self) -> None:
        """Leave."""
        self._pulse.cancel()
        self._refused.close()
        self._let_be()
        self.node.close()
