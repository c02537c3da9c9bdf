"""Commands that deploy: ``fame deploy``, ``splitter``, and ``keys`` for both.

``fame deploy`` splits a model, sends it to its robots, and waits for every one of them. ``fame splitter`` does so with
each collaboration that comes on a topic, and keeps its robots supplied. ``fame keys`` makes the keys that sign
deployments, and the identities that prove the names of robots.
"""

from __future__ import annotations

import shlex
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli import migration
from fame.cli.arguments import (
    Commands,
    add_json,
    add_key,
    add_library,
    add_trust,
    command,
    positive,
    private_key,
    trusted_keys,
)
from fame.cli.network import add_network, connected, guard, person
from fame.cli.output import note, print_json, table
from fame.errors import NOT_KNOWN, ConfigError, DeploymentError
from fame.rooms import EXPLORE_FOUND, load

if TYPE_CHECKING:
    from fame.bpmn.library import Library
    from fame.bpmn.model import Definitions
    from fame.bpmn.pools import Pool
    from fame.clock import WallScheduler
    from fame.deploy import Deployment, Report, SplitterNode
    from fame.deploy.options import DeploymentOptions
    from fame.middleware.interface import Middleware


def add_deploy(commands: Commands) -> None:
    examples = (
        "fame deploy models/ground_vehicles.bpmn",
        "fame deploy models/other.bpmn --to Tractor_2",
        "fame deploy models/reassembly.bpmn --to Arm --until-ended",
        "fame deploy new.bpmn --migrate --dry-run",
        "fame deploy new.bpmn --migrate --plan new.plan.yaml",
        "fame deploy new.bpmn --rollback-unless-ended 60",
        "fame deploy --previous",
    )
    parser = command(
        commands, "deploy", run_deploy, examples=examples,
        help="split a model and send it to the engines of its robots; all start, or none",
    )  # fmt: skip
    parser.add_argument("model", type=Path, nargs="?", metavar="MODEL.bpmn")
    parser.add_argument(
        "--previous", action="store_true",
        help="instead of a model: what the robots ran before, which they keep; all start it, or none",
    )  # fmt: skip
    parser.add_argument(
        "--to", action="append", default=[], metavar="ROBOT", help="send to this robot only; repeatable"
    )
    parser.add_argument(
        "--stay", action="store_true", help="keep running, and send robots that join late or restart their process"
    )
    parser.add_argument(
        "--until-ended", action="store_true",
        help="wait until the mission has ended on all robots; print what fails; exit code 1 if it failed",
    )  # fmt: skip
    parser.add_argument(
        "--rollback-unless-ended", type=positive, metavar="S",
        help="unless the mission has ended on all robots after S s, without a failure, deploy what they ran before; "
        "exit code 1 then",
    )  # fmt: skip
    migration.add_options(parser)
    _add_wait(parser)
    add_key(parser, "sign the deployment with this key")
    parser.add_argument(
        "--explore", action="store_true",
        help="first explore its reachable states (fame check --explore) with the robots that were found; send nothing "
        "after an error, or if a property beside the model is refuted",
    )  # fmt: skip
    parser.add_argument(
        "--allow-partial", action="store_true",
        help="with --explore or --migrate: also deploy if no error was found, but not all states were explored",
    )  # fmt: skip
    add_network(parser)
    add_library(parser)
    add_json(parser)


_FINDING = 2.0
"""How long robots are looked for that are not named (s)."""
_AT_ONCE = 0.5
"""How long a mission is watched that may fail as soon as it has started (s)."""


def _add_wait(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--wait", type=positive, metavar="S",
        help="how long to wait for answers, and for each further robot to be found (10, a second for each of "
        "more than 10, and up to 5 times as long on a busy machine); robots wait half of it, or all but 20 s, for the "
        "other ends of their topics",
    )  # fmt: skip


def run_deploy(arguments: Namespace) -> int:
    """Deploy, print how each robot answered, and what fails at once or until the end; then stay, if that is wanted."""
    from fame.bpmn.library import Library
    from fame.bpmn.pools import matches, pools_of
    from fame.bpmn.reader import read
    from fame.check.gate import refuse_errors
    from fame.middleware.wire_base import load_of_machine
    from fame.scenario import Sending

    if arguments.previous or arguments.model is None:
        return _deploy_previous(arguments)
    _check_options(arguments)
    limit: float | None = arguments.rollback_unless_ended
    definitions, library = read(arguments.model), Library(arguments.library)
    migrated = migration.Migration(arguments, definitions, library)
    key = private_key(arguments)
    names, pools = arguments.to, pools_of(definitions)
    sent = [pool.process for pool in pools if not names or any(matches(robot, pool) for robot in names)]
    refuse_errors(definitions, sent, library, sent=True)  # before any robot is looked for
    at_once = not any(pool.multi_instance for pool in pools)  # the robots are known before they are found
    if arguments.explore and at_once:
        _refuse_unexplored(definitions, library, {}, partial=arguments.allow_partial)

    with connected(arguments) as (scheduler, middleware):

        def examine(robots: Mapping[str, Pool]) -> None:
            migrated.prepare(robots)
            if arguments.explore and not at_once:
                _refuse_unexplored(definitions, library, robots, partial=arguments.allow_partial)
            for report in _reports(list(robots), scheduler, middleware, options).values() if limit else ():
                if report.differs:
                    raise DeploymentError(f"--rollback-unless-ended is not possible: {report.differs}")

        options = replace(
            migrated.options, library=library, patience=arguments.wait, load=load_of_machine, key=key, who=person()
        )
        sending = Sending(definitions, scheduler, middleware, options)
        deployment = sending.deploy(arguments.to, options.patience_of(len(names or pools)), note, examine)
        if migrated.dry:
            return migrated.show(deployment)
        failures: Mapping[str, str] = {}
        if not arguments.json:
            _print_outcome(deployment, migrated)
        if not deployment.failed:
            watched = limit or (None if arguments.until_ended else _AT_ONCE)
            failures = sending.watch(deployment, note, watched)
        rolled_back = None
        if limit and not deployment.failed and (failures or not sending.over):
            rolled_back = _roll_back(deployment, options, limit, failures)
        if arguments.json:
            _print_json(deployment, migrated, failures, rolled_back)
        if arguments.stay and deployment.started:  # a robot that has died meanwhile comes late
            deployment.close()
            sending.stay(deployment.started, note)
    return migrated.exit_code(deployment) or bool(failures) or rolled_back is not None


def _check_options(arguments: Namespace) -> None:
    if arguments.allow_partial and not (arguments.explore or arguments.migrate):
        raise ConfigError("--allow-partial needs --explore or --migrate")
    if (arguments.until_ended or arguments.rollback_unless_ended) and (arguments.stay or arguments.dry_run):
        option = "--until-ended" if arguments.until_ended else "--rollback-unless-ended"
        raise ConfigError(f"{option} cannot be given with {'--stay' if arguments.stay else '--dry-run'}")


def _roll_back(
    deployment: Deployment, options: DeploymentOptions, seconds: float, failures: Mapping[str, str]
) -> Deployment:
    """Deploy what the robots ran before. Raises DeploymentError if that is not possible."""
    from fame.scenario.deployment import deploy_previous

    note(f"{'it has failed' if failures else f'it has not ended within {seconds:g} s'}: back to what ran before")
    for robot, report in deployment.reports.items():
        if report.deployed != deployment.id:
            raise DeploymentError(f"not rolled back: {robot} runs another deployment by now, {report.deployed}")
    deployment.close()
    try:
        back = deploy_previous(deployment.told, deployment.scheduler, deployment.middleware, options, any_of=True)
    except DeploymentError as error:
        raise DeploymentError(f"not rolled back: {error}") from None
    for line in _outcome(back):
        note(line)
    if back.failed:
        note("not rolled back: all run the new process on; fame deploy --previous tries again")
    return back


def _deploy_previous(arguments: Namespace) -> int:
    """Deploy what robots ran before, and print how each answered."""
    from fame.cli.network import wait_until
    from fame.deploy import engines
    from fame.deploy.options import DeploymentOptions
    from fame.middleware.wire_base import load_of_machine
    from fame.scenario.deployment import deploy_previous

    if not arguments.previous or arguments.model is not None:
        raise ConfigError("expected either MODEL.bpmn or --previous")
    for name in ("stay", "until_ended", "migrate", "plan", "dry_run", "explore", "rollback_unless_ended"):
        if getattr(arguments, name):
            raise ConfigError(f"--{name.replace('_', '-')} cannot be given with --previous")
    key = private_key(arguments)
    wanted = set(arguments.to)
    with connected(arguments) as (scheduler, middleware):
        options = DeploymentOptions(patience=arguments.wait, load=load_of_machine, key=key, who=person())
        patience = options.patience_of(len(wanted))
        wait_until(scheduler, lambda: wanted and wanted <= set(engines(middleware)), patience if wanted else _FINDING)
        robots = arguments.to or engines(middleware)
        if missing := sorted(wanted - set(engines(middleware))) or ([] if robots else ["any robot"]):
            raise DeploymentError(f"no engine of {', '.join(missing)} was found within {patience:g} s")
        reports = _reports(robots, scheduler, middleware, options)
        deployment = deploy_previous(reports, scheduler, middleware, options, any_of=bool(wanted))
        if arguments.json:
            print_json({"status": "failed" if deployment.failed else "completed", "robots": _results(deployment)})
        else:
            print("\n".join(_outcome(deployment)))
    return int(deployment.failed)


def _reports(
    robots: Sequence[str], scheduler: WallScheduler, middleware: Middleware, options: DeploymentOptions
) -> Mapping[str, Report]:
    """Return the latest report of each robot. Raises DeploymentError if one is silent."""
    from fame.cli.network import wait_until
    from fame.cli.robots import subscribe_reports

    node = middleware.node("_fame_reports")
    trusted = [options.key.public_key()] if options.key is not None else []
    reports, _, strange = subscribe_reports(node, robots, trusted)
    patience = options.patience_of(len(robots))
    wait_until(scheduler, lambda: all(robot in reports and reports[robot].said for robot in robots), patience)
    for robot in sorted(set(robots) - reports.keys()):
        raise DeploymentError(strange.get(robot) or f"{robot} is silent")
    node.close()
    return reports


def _refuse_unexplored(
    definitions: Definitions, library: Library, robots: Mapping[str, Pool], *, partial: bool
) -> None:
    """Raise DeploymentError for a mission that may deadlock, never complete or violate a property, or may after a
    `partial` search.

    The robots are those that were `found`; a pool without one has as many as `fame check --explore` takes.
    """
    result = load(EXPLORE_FOUND)(definitions, library, robots)
    note(result.summary())
    faults = [one.text for one in result.findings if one.level == "error"]
    faults += [str(one) for one in result.properties if one.verdict == "refuted"]
    if faults:
        more = f"; and {len(faults) - 1} more: fame check --explore" if len(faults) > 1 else ""
        raise DeploymentError(f"not deployed: {faults[0]}{more}")
    if result.status == "partial":
        if not partial and not result.exhaustive:  # what needs clocks and values no search tells: runs judge it
            error = DeploymentError(f"not deployed: {result.partly()}; --allow-partial deploys it nevertheless")
            error.exit_code = NOT_KNOWN
            raise error
        note(result.partly())


def _outcome(deployment: Deployment) -> list[str]:
    """A table of how each robot answered, as lines."""
    rows = [
        (report.robot, report.state, f"{1000 * report.took:.0f} ms" if report.state != "silent" else "", report.reason)
        for report in deployment.robots.values()
    ]
    return table(("robot", "state", "time", "reason"), rows).splitlines()


def _print_outcome(deployment: Deployment, migrated: migration.Migration) -> None:
    print("\n".join(_outcome(deployment)), flush=True)
    migrated.explain(deployment)


def _results(deployment: Deployment) -> dict[str, Any]:
    """How each robot answered, for --json."""
    return {
        report.robot: {"state": report.state, "reason": report.reason, "seconds": report.took}
        for report in deployment.robots.values()
    }


def _print_json(
    deployment: Deployment, migrated: migration.Migration, failures: Mapping[str, str], rolled_back: Deployment | None
) -> None:
    back = {} if rolled_back is None else {"rolled_back": _results(rolled_back)}
    findings = {"findings": migrated.findings()} if migrated.is_explored else {}
    results = _results(deployment)
    for robot, result in results.items() if migrated.is_explored else ():
        result["tokens"] = migration.tokens_of(deployment, robot)
    status = "failed" if failures or rolled_back is not None else migrated.status(deployment)
    print_json({"status": status, "robots": results, "failures": dict(failures), **findings, **back})


def add_splitter(commands: Commands) -> None:
    parser = command(
        commands, "splitter", run_splitter, examples=("fame splitter", "fame splitter --library behaviours"),
        help="deploy the models that are published on /collaboration_diagram, also to robots that join late",
    )  # fmt: skip
    _add_wait(parser)
    add_key(parser, "sign deployments with this key, and accept only diagrams signed with it or a --trust key")
    add_trust(parser, "accept diagrams signed with this key; repeatable")
    parser.add_argument("--insecure", action="store_true", help="accept (and sign) diagrams of any sender")
    add_network(parser)
    add_library(parser)


def run_splitter(arguments: Namespace) -> int:
    """Serve until interrupted."""
    from fame.bpmn.library import Library
    from fame.deploy import SplitterNode
    from fame.deploy.options import DeploymentOptions
    from fame.middleware.wire_base import load_of_machine
    from fame.scenario import serve

    key = private_key(arguments)
    trusted = [*trusted_keys(arguments), *([key.public_key()] if key is not None else [])]
    expect_guarded = guard(arguments, trusted, "--key FILE.key")

    def build(scheduler: WallScheduler, middleware: Middleware) -> SplitterNode:
        expect_guarded(middleware)
        return SplitterNode(
            scheduler=scheduler,
            middleware=middleware,
            options=DeploymentOptions(
                library=Library(arguments.library), patience=arguments.wait, load=load_of_machine, key=key
            ),
            trusted=() if arguments.insecure else trusted,
            log=lambda text: note(f"{scheduler.now / 1e9:9.1f} s   {text}"),
        )

    serve(arguments.middleware, arguments.network, build)
    return 0


def add_keys(commands: Commands) -> None:
    parser = command(
        commands, "keys", run_keys,
        examples=(
            "fame keys new team",
            "fame keys robot REX --key team.key",
            "fame keys diagram mission.bpmn --key team.key",
        ),
        help="make the key pair of a team, which signs deployments (new); certify a robot's name; sign a diagram",
    )  # fmt: skip
    parser.add_argument("action", metavar="new|robot|diagram", choices=("new", "robot", "diagram"))
    parser.add_argument(
        "name", type=Path, metavar="NAME",
        help="new: path of the files, without suffix; robot: the same, the last part is the robot's name; diagram: "
        "the model",
    )  # fmt: skip
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="robot, diagram: the team's key")


def run_keys(arguments: Namespace) -> int:
    """Make them and name them."""
    if arguments.action == "new":
        _new(arguments.name)
    elif arguments.key is None:
        raise ConfigError(f"fame keys {arguments.action} needs --key FILE.key, the key of the team")
    elif arguments.action == "robot":
        _robot(arguments.name, arguments.key)
    else:
        _diagram(arguments.name, arguments.key)
    return 0


def _new(name: Path) -> None:
    from fame.deploy.signing import new_keys

    secret, public = new_keys(name)
    print(f"{secret}   keep it secret: {shlex.join(['fame', 'deploy', 'MODEL.bpmn', '--key', str(secret)])}")
    print(f"{public}   give it to the robots: {shlex.join(['fame', 'engine', 'ROBOT', '--trust', str(public)])}")


def _robot(name: Path, key: Path) -> None:
    from fame.deploy.signing import new_identity, read_private

    path = name.with_name(name.name + ".key")
    new_identity(name.name, read_private(key), path)
    words = ["fame", "engine", name.name, "--trust", "FILE.pub", "--identity", str(path)]
    print(f"{path}   give it to robot {name.name} alone: {shlex.join(words)}")


def _diagram(model: Path, key: Path) -> None:
    import json
    import time

    from fame.bpmn.reader import read
    from fame.deploy.authentication import Diagram
    from fame.deploy.signing import read_private

    text = read(model).source.decode()
    data = Diagram.of(text, purpose="deploy", now=time.time(), key=read_private(key)).to_json()
    print(json.dumps({"data": data}))  # as `ros2 topic pub` takes it
