"""What FAME saves by when garbage is collected (`fame.gc_tuning`): one JSON line per case, with and without, in turns.

Each case is a process of its own; `without` means that nothing changes the collector. Numbers are the processor seconds
of the case alone, the best of several turns.

    python benchmarks/garbage.py --rounds 5
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OFF = "import gc; gc.freeze = gc.disable = lambda *a: 0"
CASES = {
    "start of an engine": """
from fame.gc_tuning import uncollected
with uncollected(stays=True):
    from fame.deploy.loading import preload_all
    preload_all()
""",
    "tests of missions": """
from fame.cli import main
main(["test", "examples/tests/test_convoy.py"])
""",
    "page of a recording": """
import tempfile
from pathlib import Path
from fame.cli import main
from fame.view.replay import Replay
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "run.mcap"
    main(["run", "examples/agriculture.yaml", "--quiet", "--log", str(path)])
    begun = time.process_time()
    replay = Replay(path)
    replay.wait()
    replay.close()
""",
}


def seconds(case: str, off: bool) -> float:
    """Processor seconds of a case in a new process."""
    code = f"{OFF if off else ''}\nimport sys, time\nbegun = time.process_time()\n{CASES[case]}"
    code += "\nprint(time.process_time() - begun, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    return float(done.stderr.split()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description="What tuned garbage collection saves.")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with this in their name")
    arguments = parser.parse_args()
    for case in CASES:
        if arguments.only in case:
            found = [(seconds(case, False), seconds(case, True)) for _ in range(arguments.rounds)]
            tuned, plain = (min(each) for each in zip(*found, strict=True))
            print(json.dumps({"case": case, "tuned_s": round(tuned, 3), "plain_s": round(plain, 3),
                              "saved": round(1 - tuned / plain, 3)}), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
