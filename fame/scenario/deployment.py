"""Deploy a model to the discovered engines, and to late joiners; watch its missions until they end."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from typing import Any

from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool
from fame.clock import SECOND, Scheduler, WallScheduler
from fame.deploy import Deployment, LateJoiners, Report, engines
from fame.deploy.assignment import assign_robots
from fame.deploy.options import DeploymentOptions
from fame.deploy.sender import Sender
from fame.errors import ConfigError, DeploymentError
from fame.middleware.interface import Middleware
from fame.scenario.process import run_until_signal
from fame.scenario.quiescence import QuiescenceDetector

_FINDING = SECOND // 2
"""Extra time for discovering further engines (ns)."""


_SILENT, _LEFT = 5 * SECOND, 15 * SECOND
"""An engine without a report for as long is told, and has left (ns): a robot that roams is heard again."""
_SILENCE = f"its engine has been silent for {_SILENT // SECOND} s"
_SETTLED = 3 * SECOND // 2
"""A team whose robots say for as long that nothing runs has ended: a message on its way would have started something
(ns)."""


class MissionWatch:
    """Finds failures and the end of a deployment's missions in the reports of its `robots`, each with its pool.

    failures  by robot: its mission failed or never started, its engine left, or it got another process
    over      whether nothing runs any more
    """

    failures: dict[str, str]
    over: bool

    def __init__(self, deployment: str, robots: Mapping[str, Pool]) -> None:
        self._deployment, self._robots = deployment, robots
        self._last: dict[str, tuple[Report, int]] = {}  # of this deployment, and when it came
        self._begun: set[str] = set()
        self._quiescence = QuiescenceDetector(_SETTLED)
        self.failures, self.over = {}, False

    def look(self, reports: Mapping[str, Report], now: int) -> list[str]:
        """Take the latest reports at a time (ns), and return a line for everything that has happened since."""
        lines: list[str] = []
        for robot in self._robots:
            report, (last, since) = reports.get(robot), self._last.get(robot, (None, now))
            if report is not None and report.deployed == self._deployment:
                if last is None or (report.born, report.time) != (last.born, last.time):
                    self._last[robot] = report, now
                    if self.failures.get(robot) == _SILENCE:
                        del self.failures[robot]
                        lines.append(f"{robot}: its engine is heard again")
                elif now - since > _SILENT:
                    self._fail(lines, robot, _SILENCE)
                if report.started or report.instances:
                    self._begun.add(robot)
                if report.failed > (last.failed if last is not None else 0):
                    reason = report.error.removeprefix(f"{robot}: ") or "without a reason"
                    self._fail(lines, robot, f"the mission has failed: {reason}", again=True)
                old = last.incidents if last is not None else ()
                lines += [
                    f"{robot}: holds at {each['element']}: {each['text']}; fame retry {robot} {each['element']}"
                    for each in report.incidents if each not in old
                ]  # fmt: skip
            elif last is not None:
                self._fail(lines, robot, "another process has replaced this one")
        self.over = self._is_over(now)
        if self.over:
            self._end(lines)
        return lines

    def _end(self, lines: list[str]) -> None:
        """Say how it has ended for each robot; a pool that has to start, and of which no robot has, is a failure."""
        begun = {self._robots[robot].name for robot in self._begun}
        for robot, pool in self._robots.items():
            if pool.name not in begun and not pool.process.optional:
                self._fail(lines, robot, f"nothing has started: no robot of pool {pool.name} ran its process")
            elif robot not in self.failures:
                lines.append(f"{robot}: {'the mission has ended' if robot in self._begun else 'nothing has started'}")

    def _is_over(self, now: int) -> bool:
        there = [robot for robot in self._robots if not self._has_gone(robot, now)]
        if (there and not self._begun) or any(robot not in self._last for robot in there):
            return False
        last = {robot: self._last[robot] for robot in there}
        runs = any(report.instances or report.ahead for report, _ in last.values())
        done = None if runs else sum(report.started + report.elements for report, _ in last.values())
        return self._quiescence.look({robot: arrival for robot, (_, arrival) in last.items()}, done, now)

    def _has_gone(self, robot: str, now: int) -> bool:
        """Whether nothing is to be expected of a robot any more."""
        failure = self.failures.get(robot, "")
        if failure == _SILENCE:
            return now - self._last[robot][1] > _LEFT
        return failure != "" and not failure.startswith("the mission")

    def _fail(self, lines: list[str], robot: str, text: str, *, again: bool = False) -> None:
        if again or robot not in self.failures:
            self.failures[robot] = text
            lines.append(f"{robot}: {text}")


def deploy_previous(
    reports: Mapping[str, Report],
    scheduler: Scheduler,
    middleware: Middleware,
    options: DeploymentOptions,
    *,
    any_of: bool = False,
) -> Deployment:
    """Deploy to robots what each ran before, which they keep, by their latest `reports`; all start it, or none.

    Raises DeploymentError if one keeps nothing, or, unless they may have `any_of` several, if they ran different ones
    or one of their team is not among them.
    """
    previous: dict[str, Mapping[str, Any]] = {}
    for robot, report in sorted(reports.items()):
        said = report.said.get("previous")
        if not isinstance(said, dict):
            raise DeploymentError(report.differs or f"{robot} does not say what it ran before")
        if not said.keys() >= {"deployment", "hash", "recalls"}:
            raise DeploymentError(f"{robot} ran nothing before, or does not keep it any more")
        previous[robot] = said
    ran = {robot: str(found["deployment"]) for robot, found in previous.items()}
    if len(set(ran.values())) > 1 and not any_of:
        text = ", ".join(f"{robot} {deployment}" for robot, deployment in ran.items())
        raise DeploymentError(
            f"the robots ran different deployments before ({text}): name those that go back with --to"
        )
    team = {str(name) for found in previous.values() for name in found.get("team") or ()}
    if (absent := sorted(team - previous.keys())) and not any_of:
        text = f"{', '.join(absent)} ran {ran.popitem()[1]} too, and cannot go back: not found"
        raise DeploymentError(f"{text}; name those that go back without them with --to")
    plain = replace(options, migrate=False, preview=False, plan={})
    sender = Sender(f"back-{os.getpid()}", scheduler, middleware, plain)
    return _ended(sender.send(previous, lambda _: scheduler.stop()))


def _ended(deployment: Deployment) -> Deployment:
    """Run until a deployment has ended."""
    try:
        deployment.scheduler.run()
    except BaseException:  # Ctrl-C: abort, so that no robot waits for more
        deployment.close()
        raise
    return deployment


class Sending:
    """The deployment of a model to discovered engines."""

    definitions: Definitions
    scheduler: WallScheduler
    middleware: Middleware

    def __init__(
        self,
        definitions: Definitions,
        scheduler: WallScheduler,
        middleware: Middleware,
        options: DeploymentOptions | None = None,
    ) -> None:
        self.definitions, self.scheduler, self.middleware = definitions, scheduler, middleware
        self._sender = Sender(f"deploy-{os.getpid()}", scheduler, middleware, options or DeploymentOptions())
        self.over: bool = False

    def deploy(
        self,
        only: Sequence[str],
        patience: float,
        log: Callable[[str], object] = lambda text: None,
        examine: Callable[[Mapping[str, Pool]], object] = lambda pools: None,
    ) -> Deployment:
        """Deploy to the present engines; wait `patience` s after each that comes for those missing, reported to `log`.

        `examine` is called with the pool of each robot before anything is sent. Raises DeploymentError, ConfigError if
        some are missing, and what `examine` raises.
        """
        until = self.scheduler.now + round(patience * SECOND)
        examined: Set[str] = frozenset()
        while True:
            assigned = self._find(only, patience, log)
            if assigned.keys() != examined:
                examine(assigned)
                examined = assigned.keys()
            try:
                deployment = self._sender.send(self.definitions, lambda _: self.scheduler.stop(), only=only)
                break
            except ConfigError as error:  # an engine has left in the meantime; under load one is lost for a moment
                if self.scheduler.now > until:
                    raise DeploymentError(str(error)) from None
        return _ended(deployment)

    def watch(
        self, deployment: Deployment, log: Callable[[str], object], seconds: float | None = None
    ) -> Mapping[str, str]:
        """Watch the missions of a deployment until they have ended, or for some `seconds`; log what happens.

        Returns the failures by robot; `over` is whether all have ended.
        """
        watch = MissionWatch(deployment.id, deployment.pools)
        until = None if seconds is None else self.scheduler.now + round(seconds * SECOND)
        while not watch.over and (until is None or self.scheduler.now < until):
            self.scheduler.run(self.scheduler.now + SECOND // 20)
            for line in watch.look(deployment.reports, self.scheduler.now):
                log(line)
        self.over = watch.over
        return watch.failures

    def stay(self, served: Collection[str], log: Callable[[str], object]) -> None:
        """Deploy to robots that join late or come back, until SIGINT or SIGTERM."""
        late_joiners = LateJoiners(self.definitions, self._sender, supplied=served, log=log)
        run_until_signal(self.scheduler)
        late_joiners.close()

    def _find(self, only: Sequence[str], patience: float, log: Callable[[str], object]) -> Mapping[str, Pool]:
        """Wait until every pool has its robots, and `patience` after the last engine that came; the pool of each."""
        begun, reported, seen = self.scheduler.now, False, 0
        until = begun + round(patience * SECOND)
        before: Sequence[str] | None = None
        problem = ""
        while True:
            self.scheduler.run(self.scheduler.now + SECOND // 20)
            there = engines(self.middleware)
            if len(there) > seen:  # a machine with much to do lets them be found one after the other
                seen, until = len(there), self.scheduler.now + round(patience * SECOND)
            if there != before:  # to assign a hundred robots takes longer than to look who is there
                before = there
                try:
                    assigned = assign_robots(self.definitions, there, found=True, only=only)
                    break
                except (ConfigError, DeploymentError) as error:
                    problem = str(error)
            if self.scheduler.now >= until:
                text = f"{problem}; start an engine with: fame engine NAME (on another machine: docs/network.md)"
                raise DeploymentError(text)
            if not reported and self.scheduler.now > begun + SECOND:
                reported = True
                log(f"waiting up to {patience:g} s: {problem}")
        self.scheduler.run(self.scheduler.now + _FINDING)  # for others of a multi-instance pool
        with suppress(ConfigError, DeploymentError):  # an engine has left in the meantime: `send` says so
            assigned = assign_robots(self.definitions, engines(self.middleware), found=True, only=only)
        return assigned
