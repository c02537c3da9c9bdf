"""Zenoh over TLS: a router with a certificate, processes that trust it, and one that does not."""

from __future__ import annotations

import datetime
import ipaddress
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
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


def certify(folder: Path, name: str) -> Path:
    """Write a certificate authority and a certificate of this machine that it has signed; return the authority's."""
    now = datetime.datetime.now(datetime.UTC)

    def made(subject: str, key: Any, issuer: str, signer: Any, *, authority: bool) -> x509.Certificate:
        names = [x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)]) for text in (subject, issuer)]
        here = x509.SubjectAlternativeName(
            [x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
        )
        builder = x509.CertificateBuilder().subject_name(names[0]).issuer_name(names[1]).public_key(key.public_key())
        builder = builder.serial_number(x509.random_serial_number()).not_valid_before(now - datetime.timedelta(days=1))
        builder = builder.not_valid_after(now + datetime.timedelta(days=1)).add_extension(here, critical=False)
        return builder.add_extension(x509.BasicConstraints(authority, None), critical=True).sign(
            signer, hashes.SHA256()
        )

    root, key = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    pem, plain = serialization.Encoding.PEM, serialization.NoEncryption()
    authority = folder / f"{name}_ca.pem"
    authority.write_bytes(made(name, root, name, root, authority=True).public_bytes(pem))
    (folder / f"{name}.pem").write_bytes(made("localhost", key, name, root, authority=False).public_bytes(pem))
    (folder / f"{name}.key").write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, plain))
    return authority


class Depot:
    """A router that speaks TLS alone, in a process of its own, and the configurations of those who connect to it."""

    def __init__(self, folder: Path) -> None:
        self._folder, self.port = folder, free_port()
        self.authority = certify(folder, "depot")
        tls = {"listen_private_key": str(folder / "depot.key"), "listen_certificate": str(folder / "depot.pem")}
        end = {"endpoints": [f"tls/127.0.0.1:{self.port}"]}
        self._start(
            "router", "--zenoh-config", self._write("router", {"listen": end, "transport": {"link": {"tls": tls}}})
        )

    def _start(self, *words: str) -> None:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
        line = [sys.executable, "-m", "fame", *words]
        self.process = subprocess.Popen(line, env=environment, stderr=subprocess.PIPE, text=True)
        assert self.process.stderr is not None
        assert "Ctrl-C ends it" in self.process.stderr.readline()

    def configuration(self, name: str, authority: Path) -> str:
        """The path of a file for a process that trusts an authority, and waits 3 s for the router."""
        end = {"endpoints": [f"tls/localhost:{self.port}"], "timeout_ms": 3000}
        tls = {"root_ca_certificate": str(authority)}
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


def run_until(scheduler: WallScheduler, holds: Any, seconds: int = 30) -> None:
    deadline = scheduler.now + seconds * SECOND
    while not holds():
        assert scheduler.now < deadline
        scheduler.run(scheduler.now + SECOND // 100)


def test_who_does_not_trust_the_router_is_told_so(depot: Depot, tmp_path: Path) -> None:
    file = depot.configuration("stranger", certify(tmp_path, "elsewhere"))
    with pytest.raises(ConfigError, match=r"stranger\.json5: Zenoh does not start: "):
        ZenohMiddleware(WallScheduler(), domain=DOMAIN, network=file)


def test_two_processes_talk_over_tls(depot: Depot) -> None:
    file, scheduler = depot.configuration("friend", depot.authority), WallScheduler()
    path = os.pathsep.join((str(ROOT), *sys.path))
    echo = subprocess.Popen([sys.executable, "-c", ECHO, file, str(DOMAIN)], env=os.environ | {"PYTHONPATH": path})
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
