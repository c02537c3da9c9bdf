"""Zenoh over TLS: a router with a certificate, processes that trust it, and one that does not."""

from __future__ import annotations

import datetime
import ipaddress
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from collaborations import text_of
from domains import DOMAIN
from free_ports import free_port

pytest.importorskip("zenoh", reason="Zenoh is not installed: pip install 'fame-robots[zenoh]'")

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from fame.clock import SECOND, WallScheduler
from fame.errors import ConfigError
from fame.middleware.messages import create
from fame.middleware.zenoh import ZenohMiddleware

pytestmark = [pytest.mark.zenoh, pytest.mark.processes]

ROOT = Path(__file__).parent.parent
TEXT = "std_msgs/msg/String"
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path)), "ROS_DOMAIN_ID": str(DOMAIN)}
ECHO = """
import sys
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.zenoh import ZenohMiddleware
scheduler = DataScheduler()
node = ZenohMiddleware(scheduler, domain=int(sys.argv[2]), network=sys.argv[1]).node("echo")
node.subscription("/ping", "std_msgs/msg/String", node.publisher("/pong", "std_msgs/msg/String").publish)
scheduler.run()
"""
"""A process that publishes on /pong what it receives on /ping."""


def fame(*words: str) -> subprocess.Popen[str]:
    """A command in a process of its own."""
    line = [sys.executable, "-m", "fame", *words]
    return subprocess.Popen(line, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


class Authority:
    """A certificate authority, which signs certificates of this machine. They are files in its folder."""

    def __init__(self, folder: Path, name: str = "ca") -> None:
        self._folder, self._name, self._key = folder, name, ec.generate_private_key(ec.SECP256R1())
        self.file = folder / f"{name}.pem"
        self.file.write_bytes(self._certificate(name, self._key, authority=True))

    def certify(self, name: str) -> None:
        """Write NAME.pem, a certificate with that common name, and NAME.key."""
        key, plain = ec.generate_private_key(ec.SECP256R1()), serialization.NoEncryption()
        (self._folder / f"{name}.pem").write_bytes(self._certificate(name, key, authority=False))
        secret = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
        (self._folder / f"{name}.key").write_bytes(secret)

    def _certificate(self, subject: str, key: ec.EllipticCurvePrivateKey, *, authority: bool) -> bytes:
        now = datetime.datetime.now(datetime.UTC)
        names = [x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)]) for text in (subject, self._name)]
        here = [x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
        builder = x509.CertificateBuilder().subject_name(names[0]).issuer_name(names[1]).public_key(key.public_key())
        builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - datetime.timedelta(days=1))
        builder = builder.not_valid_after(now + datetime.timedelta(days=1))
        builder = builder.add_extension(x509.SubjectAlternativeName(here), critical=False)
        builder = builder.add_extension(x509.BasicConstraints(authority, None), critical=True)
        return builder.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


class Depot:
    """A router that speaks TLS alone, in a process of its own, and the configurations of those who connect to it."""

    def __init__(self, folder: Path) -> None:
        self._folder, self.port = folder, free_port()
        self.authority = Authority(folder)
        self.authority.certify("depot")
        tls = {"listen_private_key": str(folder / "depot.key"), "listen_certificate": str(folder / "depot.pem")}
        end = {"endpoints": [f"tls/127.0.0.1:{self.port}"]}
        self._start(
            "router", "--zenoh-config", self._write("router", {"listen": end, "transport": {"link": {"tls": tls}}})
        )

    def _start(self, *words: str) -> None:
        self.process = fame(*words)
        assert self.process.stderr is not None
        assert "Ctrl-C ends it" in self.process.stderr.readline()

    def configuration(self, name: str, authority: Authority) -> str:
        """The path of a file for a process that trusts an authority, and waits 3 s for the router."""
        end = {"endpoints": [f"tls/localhost:{self.port}"], "timeout_ms": 3000}
        tls = {"root_ca_certificate": str(authority.file)}
        return self._write(name, {"mode": "client", "connect": end, "transport": {"link": {"tls": tls}}})

    def _write(self, name: str, content: Any) -> str:
        path = self._folder / f"{name}.json5"
        path.write_text(json.dumps(content))
        return str(path)

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def depot(tmp_path: Path) -> Iterator[Depot]:
    made = Depot(tmp_path)
    yield made
    made.close()


def run_until(scheduler: WallScheduler, holds: Any, seconds: int = 60) -> None:
    deadline = scheduler.now + seconds * SECOND
    while not holds():
        assert scheduler.now < deadline
        scheduler.run(scheduler.now + SECOND // 100)


def test_who_does_not_trust_the_router_is_told_so(depot: Depot, tmp_path: Path) -> None:
    file = depot.configuration("stranger", Authority(tmp_path, "elsewhere"))
    with pytest.raises(ConfigError, match=r"stranger\.json5: Zenoh does not start: "):
        ZenohMiddleware(WallScheduler(), domain=DOMAIN, network=file)


def test_two_processes_talk_over_tls(depot: Depot) -> None:
    file, scheduler = depot.configuration("friend", depot.authority), WallScheduler()
    echo = subprocess.Popen([sys.executable, "-c", ECHO, file, str(DOMAIN)], env=ENVIRONMENT)
    friend = ZenohMiddleware(scheduler, domain=DOMAIN, network=file)
    heard: list[str] = []
    try:
        node = friend.node("asker")
        node.subscription("/pong", TEXT, lambda message: heard.append(message.data))
        publisher = node.publisher("/ping", TEXT)
        run_until(scheduler, publisher.matched)
        run_until(scheduler, lambda: heard or publisher.publish(create(TEXT, "encrypted")))
        assert set(heard) == {"encrypted"}
        (link,) = [str(link.dst) for link in friend.session.info.links()]
        assert link.startswith("tls/")
    finally:
        friend.close()
        echo.kill()
        echo.wait()


# ---- rights of each robot, as docs/network.md writes them ------------------------------------------------------------


class Base:
    """A router that knows who is connected, and files with which the operator, REX and DINGO connect to it."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port, authority = folder, free_port(), Authority(folder)
        for name in ("router", "operator", "REX", "DINGO"):
            authority.certify(name)
        page = (ROOT / "docs" / "network.md").read_text()
        section = page.partition("## A certificate for each robot")[2]
        router, robot = re.findall(r"```json5\n(.*?)```", section, re.DOTALL)[:2]
        self._write("router", router)
        for name in ("operator", "REX", "DINGO"):
            self._write(name, robot.replace("REX", name))
        self.processes = [fame("router", "--zenoh-config", self.file("router"))]
        assert self.processes[0].stderr is not None
        assert "Ctrl-C ends it" in self.processes[0].stderr.readline()

    def _write(self, name: str, text: str) -> None:
        text = text.replace("/etc/fame", str(self._folder)).replace("depot.example:7447", f"localhost:{self._port}")
        Path(self.file(name)).write_text(text.replace("0.0.0.0:7447", f"127.0.0.1:{self._port}"))

    def file(self, name: str) -> str:
        """The configuration of somebody."""
        return str(self._folder / f"{name}.json5")

    def options(self, name: str) -> tuple[str, ...]:
        """The options of a command that somebody starts."""
        return "--middleware", "zenoh", "--zenoh-config", self.file(name)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.communicate()


@pytest.fixture
def base(tmp_path: Path) -> Iterator[Base]:
    made = Base(tmp_path)
    yield made
    made.close()


def test_a_robot_publishes_in_its_own_name_only(base: Base, tmp_path: Path) -> None:
    model = tmp_path / "m.bpmn"
    model.write_text(text_of({"REX": ["timer PT1S", "throw found"], "DINGO": ["catch found"]}))
    base.processes += [fame("engine", name, "--insecure", *base.options(name)) for name in ("REX", "DINGO")]
    sent = fame("deploy", str(model), "--until-ended", *base.options("operator"))
    base.processes.append(sent)
    _, complaints = sent.communicate(timeout=60)
    assert (sent.returncode, complaints) == (0, complaints)

    scheduler = WallScheduler()
    listener = ZenohMiddleware(scheduler, domain=DOMAIN, network=base.file("operator"))
    thief = ZenohMiddleware(scheduler, domain=DOMAIN, network=base.file("REX"))
    heard = set[tuple[str, str]]()
    try:
        node, stolen = listener.node("listener"), thief.node("thief")
        topics = ("/DINGO/speech", "/lost", "/found", "/REX/speech")
        for topic in topics:
            node.subscription(topic, TEXT, lambda message, topic=topic: heard.add((topic, message.data)))  # type: ignore[misc]
        ends = [stolen.publisher(topic, TEXT) for topic in topics]
        run_until(scheduler, lambda: all(end.matched() for end in ends))
        mine = {("/found", "I am REX"), ("/REX/speech", "I am REX")}
        run_until(scheduler, lambda: heard >= mine or any(end.publish(create(TEXT, "I am REX")) for end in ends))
        assert heard == mine
    finally:
        thief.close()
        listener.close()
