"""Deploying to whoever is there."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

from fame.clock import SECOND, WallScheduler
from fame.deployment import Deployment, engines
from fame.errors import DeploymentError
from fame.middleware.interface import Middleware


def deploy(
    definitions: Any,
    middleware: Middleware,
    scheduler: WallScheduler,
    *,
    only: Sequence[str],
    library: Any,
    patience: float,
    key: Any = None,
) -> Deployment:
    """Deploy a model to the engines that are there, and wait. Raises DeploymentError if there is none."""
    until = scheduler.now + round(patience * SECOND)
    while not engines(middleware) and scheduler.now < until:
        scheduler.run(scheduler.now + SECOND // 20)
    scheduler.run(scheduler.now + SECOND // 2)  # for those who are found a little later
    if not engines(middleware):
        raise DeploymentError(f"no engine was found within {patience:g} s; start one with: fame engine NAME")
    deployment = Deployment(
        definitions,
        id=f"deploy-{os.getpid()}-{time.time_ns()}",
        sequence=time.time_ns() // 1000,
        scheduler=scheduler,
        middleware=middleware,
        ended=lambda _: scheduler.stop(),
        only=only,
        library=library,
        patience=patience,
        key=key,
    )
    deployment.begin()
    scheduler.run()
    return deployment
