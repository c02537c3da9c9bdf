"""``fame doctor``: whether this machine and its team are ready, and what mends each thing that is not."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import closing
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Literal

from fame.cli.arguments import (
    Commands,
    add_json,
    add_key,
    add_trust,
    add_types,
    command,
    positive,
    private_key,
    trusted_keys,
)
from fame.cli.fleet.installation import Finding, extras, loopback, router_port, shared_memory
from fame.cli.fleet.inventory import ask_times
from fame.cli.network import add_network, connected, interface_of, wait_until
from fame.cli.output import note, print_json
from fame.cli.robots import subscribe_reports
from fame.errors import NOT_KNOWN, ConfigError, FameError, UnavailableError
from fame.rooms import install
from fame.text import writable, write_file

if TYPE_CHECKING:
    from fame.clock import WallScheduler
    from fame.deploy import Report
    from fame.log.clocks import ClockAnswer
    from fame.middleware.interface import Middleware

PACKAGES = {"dds": "cyclonedds", "zenoh": "eclipse-zenoh", "ros": "rclpy"}
_MEND_PACKAGE = {"dds": install("dds"), "zenoh": install("zenoh"), "ros": "source /opt/ros/jazzy/setup.bash"}
_BUFFER = 2_097_152
"""Bytes that the kernel should keep of what DDS receives: messages above 64 kB come in many packets at once."""
_FREE = 100_000_000
"""Bytes that a folder of states needs at least."""
_APART = 0.1
"""Seconds that the clock of a robot may be apart from this one: dates of timers and bounds of properties read both."""
_TOLD = ("ROS_", "RMW_", "FAME_", "CYCLONEDDS_", "ZENOH_", "AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH")
"""Names, or their beginnings, of variables of the environment that matter to a fault."""
_NET = Path("/sys/class/net")
_RECEIVED = Path("/proc/sys/net/core/rmem_max")
_LOOPBACK, _MULTICAST = 0x8, 0x1000  # IFF_LOOPBACK, IFF_MULTICAST of <linux/if.h>


def add(commands: Commands) -> None:
    parser = command(
        commands, "doctor", run,
        examples=(
            "fame doctor",
            "fame doctor REX DINGO --network wlan0 --trust team.pub",
            "fame doctor --middleware zenoh --router 10.0.0.7 --state /var/lib/fame/REX --json",
            "fame doctor --report fault.json",
        ),
        help="look at this installation (packages and what each is for, shared memory, loopback) and its team (clock, "
        "network, keys, types, folders, the time to robots), each with "
        "what mends it; exit code 1 if something is wrong, otherwise 3 if something is not known",
    )  # fmt: skip
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="robots that have to be there")
    parser.add_argument("--wait", type=positive, default=5.0, metavar="S", help="how long to look for robots (5 s)")
    add_trust(parser, "read this key, and expect that robots sign what they report with keys that it vouches for")
    add_key(parser, "read this key, with which you sign missions")
    parser.add_argument("--state", type=Path, metavar="DIR", help="the folder in which an engine keeps its mission")
    add_types(parser)
    parser.add_argument(
        "--report", type=Path, metavar="FILE",
        help="also write what a report of a fault needs: this, versions of packages, the system, variables of ROS, "
        "DDS, Zenoh and FAME, and what each robot says of itself; no keys, models or recordings",
    )  # fmt: skip
    add_network(parser)
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Look at everything, print what was found, and return the exit code."""
    findings = []
    reports: dict[str, Report] = {}
    if arguments.report is not None:
        writable(arguments.report, *filter(None, (*arguments.trust, arguments.key)))
    for finding in examine(arguments, reports):
        findings.append(finding)
        if not arguments.json:
            mend = f"\n{'':<9}  -> {finding.mend}" if finding.mend else ""
            print(f"{finding.verdict:<9}  {finding.check}: {finding.text}{mend}", flush=True)
    verdicts = {finding.verdict for finding in findings}
    code = 1 if "wrong" in verdicts else NOT_KNOWN if "not known" in verdicts else 0
    found = {
        "status": {0: "completed", 1: "failed"}.get(code, "partial"),
        "findings": [one._asdict() for one in findings],
    }
    if arguments.json:
        print_json(found)
    if arguments.report is not None:
        write_file(arguments.report, json.dumps(fault_report(found, reports), indent=1) + "\n")
        note(f"{arguments.report} is written: read it before you send it, and add the model, and a recording (--log)")
    return code


def fault_report(findings: Mapping[str, Any], reports: Mapping[str, Report]) -> Mapping[str, Any]:
    """Return what somebody needs to know who is to find a fault on another machine, as JSON."""
    from fame.deploy.fields import values

    packages = {one.name: one.version for one in metadata.distributions()}
    environment = {key: value for key, value in os.environ.items() if key.startswith(_TOLD)}
    return {
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "system": f"{platform.platform()}, {os.cpu_count()} processors",
        "python": f"{platform.python_implementation()} {platform.python_version()}, {sys.executable}",
        "environment": dict(sorted(environment.items())),
        "packages": dict(sorted(packages.items(), key=lambda one: str(one[0]).lower())),
        **findings,
        "robots": {robot: values(report) for robot, report in sorted(reports.items())},
    }


def examine(arguments: Namespace, reports: MutableMapping[str, Report]) -> Iterator[Finding]:
    """Yield the findings about this machine, then about the team, the `reports` of whose robots are filled in."""
    alone = arguments.network is None and not arguments.robots
    yield from packages(arguments.middleware, needed=not alone)
    if alone:
        yield from extras()
        yield shared_memory()
        yield router_port()
    yield clock()
    of_network = list(network(arguments))
    yield from of_network
    of_keys = list(keys(arguments))
    yield from of_keys
    yield from types(arguments)
    if arguments.state is not None:
        yield folder(arguments.state)
    if any(finding.verdict == "wrong" for finding in of_keys):
        yield Finding("robots", "not known", "not asked, as the keys are wrong")
        return
    from fame.scenario import connect

    try:
        with connected(arguments) as (scheduler, middleware):
            if alone:
                with closing(connect(arguments.middleware, scheduler, arguments.network)) as other:
                    yield loopback(scheduler, middleware, other)
            team = _Team(arguments, scheduler, middleware)
            yield from team.findings()
            reports.update(team.reports)
    except FameError as error:
        if not isinstance(error, UnavailableError) and all(finding.verdict == "ok" for finding in of_network):
            raise  # a wrong request
        verdict: Literal["absent", "not known"] = "absent" if alone else "not known"
        yield Finding("robots", verdict, f"no connection: {error}")


# ---- this machine ----------------------------------------------------------------------------------------------------


def packages(backend: str, *, needed: bool = True) -> Iterator[Finding]:
    """Yield whether the middleware is installed, and is that of ROS 2's nodes here."""
    from fame.version import current as fame_version

    yield Finding("FAME", "ok", f"{fame_version()}, Python {platform.python_version()}")
    if backend not in PACKAGES:
        yield _of_another_package(backend)
        return
    name = PACKAGES[backend]
    try:
        yield Finding("middleware", "ok", f"{backend}: {name} {metadata.version(name)}")
    except metadata.PackageNotFoundError:
        verdict: Literal["wrong", "absent"] = "wrong" if needed else "absent"
        yield Finding("middleware", verdict, f"{backend}: {name} is not installed here", _MEND_PACKAGE[backend])
    chosen = os.environ.get("RMW_IMPLEMENTATION", "")
    if backend != "ros" and chosen and ("zenoh" in chosen) != (backend == "zenoh"):
        other = "zenoh" if "zenoh" in chosen else "dds"
        text = f"RMW_IMPLEMENTATION={chosen}: nodes of ROS 2 that are started here do not meet --middleware {backend}"
        yield Finding("middleware", "warning", text, f"--middleware {other}")


def _of_another_package(backend: str) -> Finding:
    from fame.config.loader import find_object, registered

    place = registered("fame.middleware")[backend]
    try:
        find_object(place, Path())
    except ConfigError as error:
        return Finding("middleware", "wrong", f"{backend}: {error.text}", "install its package again")
    return Finding("middleware", "ok", f"{backend}: {place}, of another package")


def clock() -> Finding:
    """Return whether the clock of this machine is synchronized."""
    command = ("timedatectl", "show", "--property", "NTPSynchronized", "--value")
    try:
        said = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        said = ""
    if said == "yes":
        return Finding("clock", "ok", "synchronized over the network")
    if said == "no":
        text = "not synchronized: dates of timers, recordings and signatures are those of this machine alone"
        return Finding("clock", "wrong", text, "timedatectl set-ntp true, or chrony with a server in your network")
    return Finding("clock", "not known", "timedatectl says nothing here", "compare date on each machine")


def network(arguments: Namespace) -> Iterator[Finding]:
    """Yield whether robots can find each other by the network that was asked for; routers are looked for later."""
    from fame.scenario.process import Router

    name, dds = arguments.network, arguments.middleware != "zenoh"
    domain = f"domain {os.environ.get('ROS_DOMAIN_ID') or 0}" if dds else "Zenoh"
    if name is None:
        yield Finding("network", "ok", f"{domain}, this machine only: other machines need --network or --router")
        return
    if isinstance(name, Router):
        return
    yield from _interface(str(name), domain, multicast=dds)
    if dds and _RECEIVED.exists() and (size := int(_RECEIVED.read_text())) < _BUFFER:
        text = f"the kernel keeps {size} bytes of what arrives: large messages lose parts, and are sent again"
        yield Finding("network", "warning", text, f"sysctl -w net.core.rmem_max={_BUFFER}")


def _interface(name: str, domain: str, *, multicast: bool) -> Iterator[Finding]:
    """Whether an interface, by its name or address, is up and has `multicast`; only then it is fine."""
    interface = interface_of(name)
    text = f"{domain}, {name}" if interface in (name, None) else f"{domain}, {name} ({interface})"
    place = _NET / str(interface)
    if interface is None or not place.is_dir():
        text += ": its interface was not found, so whether it is up and has multicast is not known"
        yield Finding("network", "not known", text, "--network with the name of an interface, as ip link shows it")
        return
    wrong = []
    if (place / "operstate").read_text().strip() == "down":
        wrong.append(Finding("network", "wrong", f"{text}: is down", f"ip link set {interface} up"))
    if multicast and not int((place / "flags").read_text(), 16) & (_MULTICAST | _LOOPBACK):
        mend = f"ip link set {interface} multicast on, or --middleware zenoh"
        wrong.append(Finding("network", "wrong", f"{text}: has no multicast, by which robots find each other", mend))
    yield from wrong or [Finding("network", "ok", text)]


def routed(router: str, middleware: Any) -> Finding:
    """Return whether a router of Zenoh is connected; a configuration file may name peers instead."""
    info = middleware.session.info
    routers, peers = len(info.routers_zid()), len(info.peers_zid())
    if routers:
        return Finding("network", "ok", f"Zenoh, {router}: {routers} router{'s' * (routers > 1)} connected")
    if router.startswith("/"):
        text = f"Zenoh, {router}: no router is connected, and {peers} other sessions are"
        return Finding("network", "not known", text, "look at its connect/endpoints; fame router there")
    mend = "fame router there; no firewall between"
    return Finding("network", "wrong", f"Zenoh, {router}: no router answers there", mend)


def keys(arguments: Namespace) -> Iterator[Finding]:
    """Yield whether keys can be read and fit each other."""
    if arguments.network is not None and not arguments.trust:
        text = f"without keys, everybody on {arguments.network} can send robots a process"
        yield Finding("keys", "warning", text, "fame keys new team; give engines --trust team.pub")
    try:
        trusted = trusted_keys(arguments)
        if trusted:
            yield Finding("keys", "ok", f"{len(trusted)} to trust, of {', '.join(map(str, arguments.trust))}")
        if arguments.key is not None:
            known = private_key(arguments).public_key() in trusted if trusted else True
            text = f"{arguments.key} can be read" if known else f"{arguments.key} belongs to no key of --trust"
            mend = "" if known else f"give engines --trust {arguments.key.with_suffix('.pub')}"
            yield Finding("keys", "ok" if known else "wrong", text, mend)
    except FameError as error:
        yield Finding("keys", "wrong", str(error))


def types(arguments: Namespace) -> Iterator[Finding]:
    """Yield the files of message types that were left out."""
    from fame.middleware.typesystem import broken_files

    if arguments.types:
        yield Finding("types", "ok", f"read from {', '.join(map(str, arguments.types))}")
    for text in broken_files():
        yield Finding("types", "wrong", text, "mend the file, or remove it; engines have to have the same")


def folder(path: Path) -> Finding:
    """Return whether an engine could keep its state there. Nothing is left behind."""
    there = next(each for each in (path, *path.absolute().parents) if each.exists())
    try:
        with TemporaryFile(dir=there) as file:
            file.write(b"FAME")
            file.flush()
            os.fsync(file.fileno())
        free = shutil.disk_usage(there).free
    except OSError as error:
        return Finding("state", "wrong", f"{there} cannot be written: {error.strerror}", f"chown $USER {there}")
    if free < _FREE:
        return Finding("state", "wrong", f"{free / 1e6:.0f} MB are free in {there}", "make room: states and logs grow")
    return Finding("state", "ok", f"{there} can be written, {free / 1e9:.1f} GB are free")


# ---- the team --------------------------------------------------------------------------------------------------------


class _Team:
    """The robots on the network, as their reports and answers show them."""

    def __init__(self, arguments: Namespace, scheduler: WallScheduler, middleware: Middleware) -> None:
        self._arguments, self._scheduler, self._middleware = arguments, scheduler, middleware
        self._trusted = trusted_keys(arguments)
        self._answers: dict[str, ClockAnswer] = {}
        self.reports: Mapping[str, Report] = {}

    def findings(self) -> Iterator[Finding]:
        """Yield the findings about each robot, after a while."""
        from fame.deploy import engines
        from fame.scenario.process import Router

        wanted = set(self._arguments.robots)
        note(f"looking for robots, for {self._arguments.wait:g} s{' at most' if wanted else ''}")
        wait_until(self._scheduler, lambda: wanted and wanted <= set(engines(self._middleware)), self._arguments.wait)
        robots = sorted(engines(self._middleware))
        if isinstance(self._arguments.network, Router):
            yield routed(self._arguments.network, self._middleware)
        self._ask(robots)
        for robot in robots:
            yield from self._robot(robot)
        nodes = {name for info in self._middleware.graph() for name in (*info.publishers, *info.subscribers)}
        nodes = {name for name in nodes if "_fame_doctor" not in name}
        mend = "fame engine NAME there; the same middleware, domain and network; no firewall between"
        for robot in sorted(wanted - set(robots)):
            yield Finding(robot, "wrong", f"no engine of this name was found within {self._arguments.wait:g} s", mend)
        if not robots and not wanted:
            text = f"no engine was found within {self._arguments.wait:g} s, and {len(nodes)} other nodes"
            yield Finding("robots", "not known", text, mend)

    def _ask(self, robots: list[str]) -> None:
        """Listen to the reports of robots, and ask them for their time."""
        node = self._middleware.node("_fame_doctor")
        self.reports, self._rivals, self._strange = subscribe_reports(node, robots, self._trusted)
        everyone = set(robots)
        self._answers = ask_times(
            node, self._scheduler, robots, lambda: self.reports.keys() >= everyone, self._arguments.wait
        )

    def _robot(self, robot: str) -> Iterator[Finding]:
        report, answer = self.reports.get(robot), self._answers.get(robot)
        if robot in self._rivals:
            yield Finding(robot, "wrong", "two engines have this name", f"end fame engine {robot} on one computer")
        if report is None:
            signed = " that a trusted key vouches for" if self._arguments.trust else ""
            text = self._strange.get(robot) or f"has an engine, but no report{signed}"
            yield Finding(robot, "wrong", text, f"look at the engine of {robot}, and at which FAME it runs")
        else:
            yield from self._vouched(report)
        if answer is None:
            text = "did not answer the question for its time"
            yield Finding(robot, "not known", text, "it may be busy, or have an older FAME")
        else:
            yield from answered(robot, answer)

    def _vouched(self, report: Report) -> Iterator[Finding]:
        """The state of a mission; with keys it is fine only of a robot whose name one of them vouches for."""
        from fame.deploy.authentication import proves_name

        finding, robot = reported(report), report.robot
        proved = not self._trusted or proves_name(report, robot, self._trusted)
        if not proved:
            text = "signs with a key of its own: neither its name nor which team's key it trusts is proved"
            key = self._arguments.key or Path(self._arguments.trust[0]).with_suffix(".key")
            mend = f"fame keys robot {robot} --key {key}; give its engine --identity {robot}.key"
            yield Finding(robot, "not known", f"{text} (it says: {finding.text})", mend)
        if proved or finding.verdict != "ok":
            yield finding


def reported(report: Report) -> Finding:
    """Return the state of a mission, as `fame engine --diagnostics` publishes it."""
    from fame.fleet.diagnostics import OK, WARN, diagnostic_status

    status = diagnostic_status(report)
    if status["level"] == OK:
        return Finding(report.robot, "ok", status["message"])
    return Finding(
        report.robot, "warning" if status["level"] == WARN else "wrong", status["message"],
        f"fame status --why {report.robot}",
    )  # fmt: skip


def answered(robot: str, answer: ClockAnswer) -> Iterator[Finding]:
    """Yield what a robot's answer says: how far it is, how late its clock, which version."""
    from fame.version import current as fame_version, differs

    ahead, doubt = answer.ahead / 1e9, answer.trip / 2e9
    side = "ahead" if ahead > 0 else "behind"
    text = f"answers after {answer.trip / 1e6:.1f} ms; its clock is {abs(ahead):.3f} s {side}, known to {doubt:.3f} s"
    if answer.answer.get("simulated") is True:
        yield Finding(robot, "ok", f"answers after {answer.trip / 1e6:.1f} ms; its time is that of /clock")
    elif abs(ahead) - doubt > _APART:
        yield Finding(robot, "wrong", text, f"synchronize the clock of {robot}; of a simulated team, this is no fault")
    elif abs(ahead) + doubt > _APART:
        yield Finding(robot, "not known", text, "ask again when the network is quiet")
    else:
        yield Finding(robot, "ok", text)
    version, protocol = answer.answer.get("fame"), answer.answer.get("protocol", 1)
    if isinstance(protocol, int) and (text := differs(robot, protocol, version if isinstance(version, str) else "")):
        told, _, mend = text.removeprefix(f"{robot} ").partition(": ")
        yield Finding(robot, "warning", told, mend)
    elif version != fame_version():
        told = f"runs FAME {version}" if isinstance(version, str) else "runs an older FAME"
        yield Finding(robot, "warning", f"{told}, here is {fame_version()}", "install the same on every machine")
