"""Deploy a model to the discovered engines, and to late joiners."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool
from fame.clock import SECOND, WallScheduler
from fame.deploy import Deployment, LateJoiners, engines
from fame.deploy.assignment import assign_robots
from fame.errors import ConfigError, DeploymentError
from fame.middleware.interface import Middleware
from fame.scenario.process import run_until_signal

_FINDING = SECOND // 2
"""Extra time for discovering further engines (ns)."""


class Sending:
    """The deployment of a model to discovered engines. `options` are those of `Deployment`."""

    definitions: Definitions
    scheduler: WallScheduler
    middleware: Middleware

    def __init__(
        self, definitions: Definitions, scheduler: WallScheduler, middleware: Middleware, **options: Any
    ) -> None:
        self.definitions, self.scheduler, self.middleware, self._options = definitions, scheduler, middleware, options

    def deploy(
        self,
        only: Sequence[str],
        patience: float,
        log: Callable[[str], object] = lambda text: None,
        examine: Callable[[Mapping[str, Pool]], object] = lambda pools: None,
    ) -> Deployment:
        """Deploy to the present engines and wait up to `patience` s for missing ones, which are reported to `log`.

        `examine` is called with the pool of each robot before anything is sent. Raises DeploymentError, ConfigError if
        some are missing, and what `examine` raises.
        """
        examine(self._find(only, patience, log))
        try:
            deployment = self._begin(only, (), lambda _: self.scheduler.stop())
        except ConfigError as error:  # an engine has left in the meantime
            raise DeploymentError(str(error)) from None
        try:
            self.scheduler.run()
        except BaseException:  # Ctrl-C: abort, so that no robot waits for more
            deployment.close()
            raise
        return deployment

    def stay(self, served: Collection[str], log: Callable[[str], object]) -> None:
        """Deploy to robots that join late or come back, until SIGINT or SIGTERM."""
        late_joiners = LateJoiners(
            self.definitions,
            self._begin,
            scheduler=self.scheduler,
            middleware=self.middleware,
            key=self._options.get("key"),
            supplied=served,
            log=log,
        )
        run_until_signal(self.scheduler)
        late_joiners.close()

    def _find(self, only: Sequence[str], patience: float, log: Callable[[str], object]) -> Mapping[str, Pool]:
        """Wait until every pool has its robots; the pool of each robot."""
        begun, reported = self.scheduler.now, False
        until = begun + round(patience * SECOND)
        while True:
            self.scheduler.run(self.scheduler.now + SECOND // 20)
            try:
                found = assign_robots(self.definitions, engines(self.middleware), found=True, only=only)
            except (ConfigError, DeploymentError) as error:
                if self.scheduler.now < until:
                    if not reported and self.scheduler.now > begun + SECOND:
                        reported = True
                        log(f"waiting up to {patience:g} s: {error}")
                    continue
                text = f"{error}; start an engine with: fame engine NAME"
                raise DeploymentError(text) from None
            break
        self.scheduler.run(self.scheduler.now + _FINDING)  # for others of a multi-instance pool
        with suppress(ConfigError, DeploymentError):  # an engine has left in the meantime: `_begin` says so
            found = assign_robots(self.definitions, engines(self.middleware), found=True, only=only)
        return found

    def _begin(self, only: Sequence[str], again: Collection[str], ended: Callable[[Deployment], object]) -> Deployment:
        number = time.time_ns()
        deployment = Deployment(
            self.definitions,
            id=f"deploy-{os.getpid()}-{number}",
            sequence=number // 1000,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=ended,
            only=only,
            again=again,
            **self._options,
        )
        deployment.begin()
        return deployment
