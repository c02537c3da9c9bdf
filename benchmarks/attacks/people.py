"""Attacks on what people see, and on the files that they take from elsewhere."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from zipfile import ZIP_DEFLATED, ZipFile

from attacks.field import ROOT, TEAM, Field, held, scripted
from fame.deploy import STRING
from fame.middleware.messages import create

ODD = (
    {"offers": [1, 2]},
    {"waits": [{"element": "e", "for": "f", "since": 10**400, "topics": {}}]},
    {"now": 10**400},
    {"error": "\x1b[2J\x1b[31mred"},
    {"state": "idle\nFAKE  running"},
    {"waits": [{"element": "e\n\x1b[1A", "for": "f\r", "since": 1, "topics": {"t\x1b": 1}}]},
)


def odd_reports(field: Field) -> None:
    """Reports that are forged or odd, as somebody looks at fame status."""
    field.run("A", scripted("log('\\x1b[2Jfaked\\nline')"))
    for number, changes in enumerate(ODD):
        topic = f"/X{number}/bpmn_status"
        publisher = field.publisher(topic, within=0)  # nobody is there yet
        report = {"robot": f"X{number}", "state": "idle", "born": 1, **changes}

        def again(publisher=publisher, report=report) -> None:
            publisher.publish(create(STRING, json.dumps(report)))
            field.scheduler.after(300_000_000, again)

        again()
    looking = subprocess.Popen(
        [sys.executable, "-m", "fame", "status"], env=field.environment, cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    end = time.monotonic() + 30
    while looking.poll() is None and time.monotonic() < end:
        field.pass_time(0.1)
    said = looking.communicate()[0]
    held(looking.returncode == 0, said)
    held("bug in FAME" not in said, said)
    held("\x1b" not in said and "\nFAKE" not in said, "escape sequences are printed")
    held("\x1b" not in field.engines[0].said, "escape sequences are logged")


def stopped_engine(field: Field) -> None:
    """An engine of a team is stopped: fame status shows it as silent."""
    field.start("A")
    stopped = field.start("B")
    held(field.fame("deploy", field.file("team.bpmn", TEAM)).returncode == 0, "not deployed")
    field.pass_time(2)
    stopped.tell(signal.SIGSTOP)
    field.pass_time(5)
    said = field.fame("status").stdout
    stopped.tell(signal.SIGCONT)
    held("B" in said and "silent" in said, f"not shown as silent: {said!r}")


BOMB = """
import resource
from fame.monitor.anomaly.model import Model
try:
    Model.load({path!r})
except Exception as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000)
"""


def model_bomb(field: Field) -> None:
    """A stored model of half a megabyte that would unpack to 600 MB."""
    path = field.folder / "m.skops"
    with ZipFile(path, "w", ZIP_DEFLATED, compresslevel=1) as packed, packed.open("schema.json", "w") as member:
        for _ in range(600):
            member.write(bytes(1_000_000))
    command = [sys.executable, "-c", BOMB.format(path=str(path))]
    done = subprocess.run(command, env=field.environment, cwd=ROOT, capture_output=True, text=True, check=False)
    text, _, peak = done.stdout.strip().rpartition("\n")
    held("unpack" in text, f"not refused: {done.stdout}{done.stderr}")
    held(int(peak) < 400, f"takes {peak} MB")
