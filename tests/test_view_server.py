"""Who gets to see a page: only requests with its token, to its name, from itself."""

from __future__ import annotations

import json
import select
import socket
import ssl
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from datetime import datetime
from http.client import HTTPConnection, HTTPSConnection
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from view_page import eventually

from fame.bpmn.model import Human
from fame.errors import ConfigError, FameError
from fame.view import Server, server as page_server
from fame.view.people import TAKE_OVER, Person


class OneRobot:
    """A source with nothing to see, that keeps the commands that it gets."""

    def __init__(self) -> None:
        self.commands: list[Mapping[str, Any]] = []

    def mission(self) -> Mapping[str, Any]:
        return {"title": "<script>alert(1)</script>", "robots": [{"name": "REX"}]}

    def plane(self, number: int) -> Mapping[str, Any]:
        raise LookupError(number)

    def block(self, number: int) -> Mapping[str, Any]:
        return {"number": [0, 1][number]}

    def news(self, known: Any) -> tuple[Any, list[Mapping[str, Any]]]:
        return True, [] if known else [{"type": "hello"}]

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        if "do" not in command:
            raise FameError("nothing to do")
        self.commands.append(command)
        return {"said": "done"}

    def tasks(self, element: str) -> list[Human]:
        return [Human(groups=("nurse",))] if element == "Hand_Over" else []


@pytest.fixture
def server() -> Iterator[Server]:
    with Server(OneRobot()) as found:
        yield found


@pytest.fixture(scope="module")
def shared() -> Iterator[Server]:
    """A server for tests that ask, and change nothing."""
    with Server(OneRobot()) as found:
        yield found


def ask(
    server: Server, path: str, method: str = "GET", *, token: str | None = None, body: str = "", **headers: str
) -> tuple[int, Mapping[str, str], bytes]:
    """The answer to a request: status, headers, content."""
    connection = HTTPConnection("127.0.0.1", server.port, timeout=60)
    prefix = f"/{server.token if token is None else token}" if token != "" else ""
    sent = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, prefix + path, body.encode() or None, sent)
    answer = connection.getresponse()
    found = answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    connection.close()
    return found


def test_the_page_is_served_under_its_token(shared: Server) -> None:
    status, headers, content = ask(shared, "/")
    assert status == 200
    assert b"main.js" in content
    assert headers["content-type"].startswith("text/html")
    assert "script-src 'self'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]


@pytest.mark.parametrize("name", ["main.js", "style.css", "icon.svg"])
def test_the_files_of_the_page_are_served(shared: Server, name: str) -> None:
    assert ask(shared, f"/page/{name}")[0] == 200


@pytest.mark.parametrize("path", ["/", "/mission.json", "/page/main.js", "/block/0.json"])
@pytest.mark.parametrize("token", ["", "wrong", "x" * 24])
def test_without_the_token_there_is_nothing(shared: Server, path: str, token: str) -> None:
    assert ask(shared, path, token=token)[0] == 404


@pytest.mark.parametrize("name", ["../server.py", "%2e%2e/server.py", "..%2fserver.py", "nothing.js", "main.py", ""])
def test_only_files_of_the_page_are_served(shared: Server, name: str) -> None:
    assert ask(shared, f"/page/{name}")[0] == 404


def test_what_is_missing_is_told_from_a_fault_of_the_source(shared: Server) -> None:
    asked = ("/block/1.json", "/plane/7.json", "/at/7.json", "/block/7.json")
    assert [ask(shared, path)[0] for path in asked] == [200, 404, 404, 500]


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1:1", "localhost.evil.example:{port}"]
)
def test_another_host_is_refused(shared: Server, host: str) -> None:
    assert ask(shared, "/mission.json", Host=host.format(port=shared.port))[0] == 421


def test_this_host_has_several_names(shared: Server) -> None:
    for host in ("127.0.0.1", "localhost"):
        assert ask(shared, "/mission.json", Host=f"{host}:{shared.port}")[0] == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"])
def test_another_origin_is_refused(server: Server, origin: str) -> None:
    given = origin.format(port=server.port)
    assert ask(server, "/control", "POST", body='{"do": "pause"}', Origin=given)[0] == 403
    assert {one["do"] for one in server.source.commands} <= {"note"}  # type: ignore[attr-defined]


def test_the_page_itself_may_send_commands(server: Server) -> None:
    origin = f"http://127.0.0.1:{server.port}"
    status, _, content = ask(server, "/control", "POST", body='{"do": "pause"}', Origin=origin)
    assert (status, json.loads(content)) == (200, {"said": "done"})


@pytest.mark.parametrize(("body", "status"), [("{}", 409), ("[]", 400), ("nothing", 400), ("", 400), ('"x"', 400)])
def test_a_wrong_command_is_answered(server: Server, body: str, status: int) -> None:
    found, _, content = ask(server, "/control", "POST", body=body)
    assert found == status
    assert "error" in json.loads(content)


def test_a_command_is_never_a_get(server: Server) -> None:
    assert ask(server, "/control")[0] == 405


def handshake(server: Server) -> dict[str, str]:
    """The headers that ask for a WebSocket."""
    return {
        "Host": f"127.0.0.1:{server.port}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "x3JJHMbDL1EzLkh9GBhXDw==",
        "Sec-WebSocket-Version": "13",
    }


def upgrade(server: Server, **headers: str) -> bytes:
    """The first line of the answer to a WebSocket."""
    lines = handshake(server) | headers
    with socket.create_connection(("127.0.0.1", server.port), timeout=60) as stream:
        text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
        stream.sendall(f"GET /{server.token}/live HTTP/1.1\r\n{text}\r\n".encode())
        return stream.recv(4096).partition(b"\r\n")[0]


def test_what_was_refused_is_in_the_logs_of_the_robots_but_does_not_fill_them(server: Server) -> None:
    assert isinstance(server.source, OneRobot)
    for _ in range(3):
        ask(server, "/control", "POST", body='{"do": "pause"}', Origin="http://evil.example/\x85" + 200 * "x")
    (note,) = eventually(lambda: server.source.commands)
    assert (note["robot"], note["text"]) == ("REX", "a command to the page refused, asked for")
    assert note["who"].startswith("http://evil.example/\\x85xxx")
    assert len(note["who"]) < 110
    ask(server, "/", token="x" * 24)  # who guesses a token is refused, but writes nothing
    assert len(server.source.commands) == 1


def test_a_websocket_of_another_origin_is_refused(server: Server) -> None:
    assert b"101" in upgrade(server, Origin=f"http://127.0.0.1:{server.port}")
    assert b"403" in upgrade(server, Origin="http://evil.example")


def test_a_page_without_news_gets_a_beat(server: Server) -> None:
    with socket.create_connection(("127.0.0.1", server.port), timeout=60) as stream:
        lines = [
            f"GET /{server.token}/live HTTP/1.1",
            *(f"{name}: {value}" for name, value in handshake(server).items()),
        ]
        stream.sendall("\r\n".join([*lines, "", ""]).encode())
        received = b""
        while received.count(b'{"type":"beat"}') < 2:
            received += stream.recv(4096)
    assert received.index(b"hello") < received.index(b"beat")


def test_a_port_in_use_is_refused_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=f"cannot serve the page on 127.0.0.1 port {port}"):
            Server(OneRobot(), port=port)


def test_the_page_loads_nothing_from_elsewhere() -> None:
    folder = Path(__file__).parent.parent / "fame" / "view" / "page"
    for file in folder.iterdir():
        text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text, file
        assert "https://" not in text, file


@pytest.mark.parametrize(
    "word", ["innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "new Function"]
)
def test_the_page_never_makes_markup_of_text(word: str) -> None:
    folder = Path(__file__).parent.parent / "fame" / "view" / "page"
    for file in folder.glob("*.js"):
        assert word not in file.read_text(encoding="utf-8"), file


@pytest.mark.parametrize(
    ("body", "expected"), [("[" * 5000, 400), ('{"do": ' + "9" * 5000 + "}", 400), ("{" * (10**6 + 1), 413)]
)
def test_commands_are_bounded(server: Server, body: str, expected: int) -> None:
    status, _, content = ask(server, "/control", "POST", body=body)
    assert status == expected
    assert json.loads(content)["error"]
    assert server.source.commands == []  # type: ignore[attr-defined]


# ---- encrypted -------------------------------------------------------------------------------------------------------


def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate of 127.0.0.1 that nobody else has signed, and its private key."""
    x509 = pytest.importorskip("cryptography.x509")
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "x")])
    there = x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))])
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    made = made.serial_number(1).not_valid_before(datetime(2020, 1, 1)).not_valid_after(datetime(2090, 1, 1))
    signed = made.add_extension(there, critical=False).sign(key, hashes.SHA256())
    encoding, none = serialization.Encoding.PEM, serialization.NoEncryption()
    (folder / "page.crt").write_bytes(signed.public_bytes(encoding))
    (folder / "page.pem").write_bytes(key.private_bytes(encoding, serialization.PrivateFormat.PKCS8, none))
    return folder / "page.crt", folder / "page.pem"


def test_with_a_certificate_the_page_is_encrypted_and_answers_only_its_encrypted_self(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    with Server(OneRobot(), tls=files) as server:
        assert server.address.startswith("https://127.0.0.1:")
        context = ssl.create_default_context(cafile=str(files[0]))
        with urlopen(f"{server.address}page/fame.webmanifest", context=context) as answer:
            assert json.loads(answer.read())["start_url"] == "../"
        statuses = []
        for scheme in ("https", "http"):
            origin = {"Origin": f"{scheme}://127.0.0.1:{server.port}"}
            connection = HTTPSConnection("127.0.0.1", server.port, timeout=60, context=context)
            connection.request("POST", f"/{server.token}/control", json.dumps(COMPLETE), origin)
            statuses.append(connection.getresponse().status)
            connection.close()
        assert statuses == [200, 403]


def test_files_that_are_no_certificate_with_its_key_are_refused(tmp_path: Path) -> None:
    (tmp_path / "page.crt").write_text("nothing")
    for key in ("page.crt", "missing.pem"):
        with pytest.raises(ConfigError, match="--tls: expected a certificate and its private key"):
            Server(OneRobot(), tls=(tmp_path / "page.crt", tmp_path / key))


# ---- people with an address of their own -----------------------------------------------------------------------------

COMPLETE = {"do": "complete", "robot": "REX", "element": "Hand_Over"}


@pytest.mark.parametrize(
    ("role", "command", "refused"),
    [
        ("nurse", COMPLETE, ""),
        ("technician", COMPLETE, "Hand_Over is a task of nurse, not of ann (technician)"),
        ("technician", {**COMPLETE, "element": "Anything"}, ""),
        ("nurse", {**COMPLETE, "do": "take_over"}, "ann (nurse) may only complete tasks"),
        ("nurse", {**COMPLETE, "do": "retry"}, "ann (nurse) may only complete tasks"),
        ("nurse", {**COMPLETE, "do": "skip", "who": "the boss"}, "ann (nurse) may only complete tasks"),
    ],
)
def test_a_person_completes_the_tasks_of_their_role_and_does_nothing_else(
    role: str, command: Mapping[str, str], refused: str
) -> None:
    source, ann = OneRobot(), Person("ann", role)
    with Server(source, people=[ann]) as server:
        assert server.addresses[ann] != server.address
        status, _, content = ask(server, "/control", "POST", token=ann.token, body=json.dumps(command))
    assert (status, json.loads(content).get("error", "")) == (409 if refused else 200, refused)
    note = {"do": "note", "robot": "REX", "text": f"{command['do']} refused: {refused}, asked for"}
    assert source.commands == [{**(note if refused else command), "who": f"ann ({role})"}]  # a refusal is recorded


def test_people_of_a_role_that_may_take_robots_over_do_nothing_else_besides() -> None:
    source, bob = OneRobot(), Person("bob", "technician", TAKE_OVER)
    take, move = ({"do": act, "robot": "REX", "lease": "1"} for act in ("take_over", "move"))
    with Server(source, people=[bob]) as server:
        for command in (take, move):
            _, _, content = ask(server, "/control", "POST", token=bob.token, body=json.dumps(command))
    assert json.loads(content)["error"] == "bob (technician) may only complete tasks and take robots over"
    assert [command["do"] for command in source.commands] == ["take_over", "note"]
    assert source.commands[0] == {**take, "who": "bob (technician)"}


def test_the_page_of_a_person_says_who_it_is_for_and_the_other_one_names_nobody() -> None:
    source, ann = OneRobot(), Person("ann", "nurse")
    with Server(source, people=[ann]) as server:
        hers = json.loads(ask(server, "/mission.json", token=ann.token)[2])
        assert hers["person"] == {"user": "ann", "role": "nurse"}
        assert "person" not in json.loads(ask(server, "/mission.json")[2])
        ask(server, "/control", "POST", body=json.dumps({**COMPLETE, "who": "somebody else"}))
    assert source.commands == [COMPLETE]


# ---- connections that ask for nothing --------------------------------------------------------------------------------


def closed(ends: list[socket.socket]) -> int:
    """How many of some connections the server has closed."""
    return sum(select.select([end], [], [], 0)[0] != [] for end in ends)


def test_connections_without_a_request_keep_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "WAITING", 5)
    source = OneRobot()
    with Server(source) as server, ExitStack() as opened:
        ends = [opened.enter_context(socket.create_connection((server.host, server.port))) for _ in range(20)]
        for end in ends[:10]:
            end.sendall(b"GET / HTTP/1.1\r\nHost: ")
        eventually(lambda: closed(ends) == 15)
        with urlopen(server.address) as page:
            assert page.status == 200
        eventually(lambda: source.commands)
        (told,) = source.commands
        assert told["text"].startswith("a connection without a request refused")


def test_a_connection_makes_its_request_in_time_or_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "PATIENCE", 0.1)
    with Server(OneRobot()) as server, socket.create_connection((server.host, server.port)) as idle:
        asked = HTTPConnection(server.host, server.port)
        with closing(asked):
            asked.request("GET", f"/{server.token}/")
            assert asked.getresponse().read()
            eventually(lambda: closed([idle]) == 1)
            asked.request("GET", f"/{server.token}/")
            assert asked.getresponse().read()
            asked.request("GET", "/")
            assert asked.getresponse().getheader("Connection") == "close"
