"""How a fleet starts on a machine that has far too much to do: found, deployed to and started, over Zenoh.

One command starts the engines (a process each), another one deploys to them: the first robot throws a signal, all
others catch it. Beside them `BURNERS` processes do nothing but compute. One JSON line per round. Run as
``python -m benchmarks.fleet [ENGINES [ROUNDS [BURNERS]]]``; exit code 1 unless all started in every round.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))
from attacks.team import mission  # noqa: E402

PATIENCE = 1200.0
"""s of a round, at most."""


def fame(*words: str, out: Any) -> subprocess.Popen[str]:
    """Start a command of FAME over Zenoh."""
    command = [sys.executable, "-m", "fame", *words, "--middleware", "zenoh"]
    return subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, text=True, cwd=ROOT)


def start(engines: int, folder: Path) -> dict[str, Any]:
    """One round: when all engines waited for a process, and how the deployment ended (s since the start of each)."""
    names = [f"R{number}" for number in range(engines)]
    model, said, begun = folder / "fleet.bpmn", folder / "engines.txt", time.monotonic()
    model.write_text(mission(1, names))
    with said.open("w") as log:
        fleet = fame("engine", *names, "--insecure", out=log)
    try:
        while said.read_text().count("waits for its process") < engines:
            if fleet.poll() is not None or time.monotonic() > begun + PATIENCE:
                return {"result": "engines did not start", "said": said.read_text()[-300:]}
            time.sleep(0.2)
        there, deployed = time.monotonic() - begun, time.monotonic()
        sender = fame("deploy", str(model), out=subprocess.PIPE)
        text = sender.communicate(timeout=PATIENCE)[0]
        rows = [line.split() for line in text.splitlines()]
        started = sum(len(row) > 1 and row[1] == "started" for row in rows)
        took = round(time.monotonic() - deployed, 1)
        others = Counter(" ".join(row[1:]) for row in rows if row[1:2] != ["started"])
        why = "; ".join(f"{number} times {text[:200]}" for text, number in others.most_common(5))
        result = "started" if sender.returncode == 0 and started == engines else why
        return {"result": result, "started": started, "engines_s": round(there, 1), "deployment_s": took}
    finally:
        fleet.terminate()
        fleet.wait(60)


def main(engines: int = 100, rounds: int = 10, burners: int = 28) -> int:
    """Print each round."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # end the engines, too
    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(burners)]
    good = 0
    try:
        for number in range(1, rounds + 1):
            with TemporaryDirectory(prefix="fame-fleet-") as folder:
                found = start(engines, Path(folder))
            good += found["result"] == "started"
            print(json.dumps({"round": number, **found, "load": round(os.getloadavg()[0], 1)}), flush=True)
    finally:
        for burner in burning:
            burner.kill()
            burner.wait()
    print(json.dumps({"good": good, "of": rounds, "engines": engines, "burners": burners}))
    return int(good < rounds)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
