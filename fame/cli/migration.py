"""Options of ``fame deploy`` for migrations: preview and check what would happen to every token."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Parser
from fame.cli.output import note, print_json, table
from fame.errors import NOT_KNOWN, ConfigError, FameError
from fame.rooms import EXPLORE_MIGRATED, EXPLORE_OBJECTION, FINDING_AS_JSON, load

if TYPE_CHECKING:
    from fame.bpmn.library import Library
    from fame.bpmn.model import Definitions
    from fame.bpmn.pools import Pool
    from fame.deploy import Deployment
    from fame.deploy.migration import Foreseen
    from fame.deploy.options import DeploymentOptions

_OPTIONS = ("plan", "dry_run", "force")


def add_options(parser: Parser) -> None:
    parser.add_argument(
        "--migrate", action="store_true",
        help="migrate running instances to this model instead of cancelling them: all robots or none "
        "(docs/repair.md)",
    )  # fmt: skip
    parser.add_argument(
        "--plan", type=Path, metavar="PLAN.yaml",
        help="with --migrate: the mapping of elements and variables that have changed",
    )  # fmt: skip
    parser.add_argument(
        "--dry-run", action="store_true",
        help="with --migrate: change nothing; list what would happen to each token, and write a plan to edit "
        "(MODEL.plan.yaml) unless --plan is given",
    )  # fmt: skip
    parser.add_argument(
        "--force", action="store_true",
        help="with --migrate: migrate even if a robot could then wait forever, or if that could not be explored",
    )  # fmt: skip


_PREPARATION = 0.5
"""How long a search may take that only prepares another one (s)."""


class Migration:
    """The migration that the arguments of a command ask for. Raises ConfigError for options without --migrate."""

    def __init__(self, arguments: Namespace, definitions: Definitions, library: Library) -> None:
        from fame.deploy.migration import read_plan
        from fame.deploy.options import DeploymentOptions

        for name in _OPTIONS:
            if getattr(arguments, name) and not arguments.migrate:
                text = "without it what runs is cancelled"
                raise ConfigError(f"--{name.replace('_', '-')} needs --migrate: {text}")
        self.dry: bool = arguments.dry_run
        self._force, self._plan, self._json = arguments.force, arguments.plan, arguments.json
        self._model, self._definitions, self._library = arguments.model, definitions, library
        self._found: list[Any] = []  # of an exploration
        self._allow_partial: bool = arguments.allow_partial
        self._partial = self._unmet = False
        plan = read_plan(arguments.plan) if arguments.plan is not None else {}
        if self._force:
            plan = {**plan, "forced": True}  # for the log of each robot
        self.options: DeploymentOptions = DeploymentOptions(
            migrate=arguments.migrate, plan=plan, preview=arguments.dry_run
        )
        self.is_explored: bool = arguments.migrate and not arguments.dry_run
        if self.is_explored:
            self.options = replace(self.options, approve=self._approve)

    def prepare(self, pools: Mapping[str, Pool]) -> None:
        """Load and compile what the exploration needs while the robots still run: then they are held for less time."""
        if self.is_explored:
            with suppress(FameError):
                load(EXPLORE_MIGRATED)(self._definitions, self._library, pools, {}, seconds=_PREPARATION)

    def _approve(self, pools: Mapping[str, Pool], foreseen: Mapping[str, Foreseen]) -> str:
        """Look at the plan, and explore the state that the robots would have, in a thread, while they are held."""
        try:
            self._expect_met(foreseen)
        except ConfigError as error:
            self._unmet = True
            return str(error)
        try:
            result = load(EXPLORE_MIGRATED)(self._definitions, self._library, pools, foreseen)
        except FameError as error:  # nothing is explored
            self._partial = not self._force
            return self._overridable(str(error), "--force overrides")
        note(f"the migrated state: {result.summary()}")
        self._found = [one for one in result.findings if one.level == "error"]
        reason: str = load(EXPLORE_OBJECTION)(result, partial=self._force or self._allow_partial)
        self._partial = bool(reason) and not self._force and not self._found
        return self._overridable(reason, "--force overrides" if self._found else "--allow-partial or --force overrides")

    def _expect_met(self, foreseen: Mapping[str, Foreseen]) -> None:
        """Raise ConfigError if the plan names elements that are not there; warn of variables."""
        from fame.deploy.migration import expect_met, unset_variables

        if self._plan is not None:
            expect_met(self._plan, foreseen)
            for text in unset_variables(self._plan, foreseen):
                note(f"warning: {text}")

    def _overridable(self, reason: str, options: str) -> str:
        """Return why the migration is refused, with the options that override it; empty if --force does."""
        if reason and self._force:
            note(f"overridden by --force: {reason}")
        return f"{reason} ({options})" if reason and not self._force else ""

    def status(self, deployment: Deployment) -> str:
        """``completed``; ``failed``; ``partial`` if it failed since the migrated state could not be explored whole."""
        return "completed" if not deployment.failed else "partial" if self._partial else "failed"

    def exit_code(self, deployment: Deployment) -> int:
        return 2 if self._unmet else {"completed": 0, "failed": 1, "partial": NOT_KNOWN}[self.status(deployment)]

    def explain(self, deployment: Deployment) -> None:
        """Say whether it is refused, what the exploration found, who starts late, and what changes at tokens."""
        if (
            self.is_explored
            and any(each.state == "refused" for each in deployment.robots.values())
            and not deployment.started
        ):
            note("the migration is refused: all robots continue with what they had")
        if self.is_explored and not deployment.failed:
            from fame.deploy.assignment import late_starts

            running = [robot for robot, one in deployment.foreseen.items() if one.hash]
            for text in late_starts(self._definitions, deployment.pools, self._library, running):
                note(f"warning: {text}")
            for robot, foreseen in deployment.foreseen.items():
                for token in foreseen.tokens:
                    if token.reason:
                        note(f"{robot}: {token}")
        for finding in self._found:
            note(f"{finding.level} in the migrated state: {finding.text}")
            for line in finding.steps():
                note(line)

    def findings(self) -> list[dict[str, Any]]:
        """Return the findings of the exploration, for --json."""
        return [load(FINDING_AS_JSON)(one) for one in self._found]

    def show(self, deployment: Deployment) -> int:
        """Print what a dry run has found, and write a plan. Returns the exit code: 1 if it is not possible.

        Raises ConfigError if the plan names what is not there.
        """
        foreseen = deployment.foreseen
        if foreseen.keys() >= deployment.robots.keys():  # else what it names may be of a robot that did not answer
            self._expect_met(foreseen)
        blocked = any(one.blocked for one in foreseen.values())
        failed = deployment.failed or blocked
        if self._json:
            robots = {
                report.robot: {
                    "state": report.state,
                    "reason": report.reason,
                    "tokens": tokens_of(deployment, report.robot),
                }
                for report in deployment.robots.values()
            }
            print_json({"status": "failed" if failed else "completed", "robots": robots})
        else:
            print(table(("robot", "model", "token at", "becomes", "reason"), _rows(deployment)), flush=True)
        if self._plan is None and any(one.tokens or one.gone for one in foreseen.values()):
            self._write(foreseen)
        return 1 if failed else 0

    def _write(self, foreseen: Mapping[str, Foreseen]) -> None:
        from fame.deploy.migration import write_plan

        path = Path(f"{self._model.stem}.plan.yaml")
        if path.exists():  # it may have been edited
            note(f"{path} is kept as it is: give it with --plan, or remove it to get a new one")
            return
        write_plan(path, foreseen)
        note(f"wrote {path}: edit it, then fame deploy {self._model} --migrate --plan {path}")


def tokens_of(deployment: Deployment, robot: str) -> list[dict[str, Any]]:
    """Return what becomes of each token of a robot, for --json."""
    foreseen = deployment.foreseen.get(robot)
    return list(foreseen.to_json()["tokens"]) if foreseen is not None else []


def _rows(deployment: Deployment) -> Sequence[tuple[str, ...]]:
    """A line for each token, and one for a robot without any."""
    rows = []
    for report in deployment.robots.values():
        foreseen = deployment.foreseen.get(report.robot)
        tokens = foreseen.tokens if foreseen is not None else ()
        for token in tokens:
            place = f'"{token.name}" ({token.element})' if token.name else token.element
            target = f" as {token.target}" if token.target not in ("", token.element) else ""
            assert foreseen is not None
            rows.append(
                (report.robot, foreseen.hash[:12], place, token.fate + target * (token.fate != "blocked"), token.reason)
            )
        if not tokens:
            becomes, reason = report.state, report.reason
            if becomes == "previewed":
                becomes, reason = "takes the model", reason or "nothing runs"
            rows.append((report.robot, foreseen.hash[:12] if foreseen is not None else "", "", becomes, reason))
    return rows
