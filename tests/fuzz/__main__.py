"""``python -m tests.fuzz --minutes 60 [--target NAME ...]``: damaged input for every reader; exit code 1 if one failed.

Each reader runs in a child process, which may take `trial.BYTES` of memory beyond what it had, and is ended if one
input takes long. An input that fails is reduced and written to ``tests/fuzz/found``: it is an input of the tests then.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import sys
import time
from hashlib import sha256
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path

from .targets import BY_NAME, TARGETS, Target
from .trial import BYTES, SECONDS, failure, kind, reduced

FOUND = Path(__file__).parent / "found"
ROUND = 20.0
"""How long a reader is tried before the next one (s)."""


def attempt(name: str, first: int, seconds: float, known: frozenset[str], pipe: Connection) -> None:
    """In a child process: try the inputs of a reader from a number on, and tell each number and each new failure."""
    target = BY_NAME[name]
    for data in target.valid:
        failure(target, data)  # what is made once is no input's memory
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + BYTES, resource.RLIM_INFINITY))
    until, number, seen = time.monotonic() + seconds, first, set(known)
    while time.monotonic() < until:
        pipe.send(("begins", number, ""))
        why = failure(target, target.input(number), timed=True)
        if why and kind(why) not in seen:
            seen.add(kind(why))
            pipe.send(("failed", number, why))
        number += 1
    pipe.send(("ended", number, ""))


class Fuzzing:
    """What was tried and found so far. `report` gets lines for people."""

    def __init__(self, seed: int) -> None:
        self.seed, self.failures = seed, 0
        self.next: dict[str, int] = {}
        self.kinds: dict[str, set[str]] = {}

    def round(self, target: Target, seconds: float) -> None:
        """Try a reader for some seconds."""
        number = self.next.setdefault(target.name, self.seed)
        known = frozenset(self.kinds.setdefault(target.name, set()))
        ours, theirs = multiprocessing.Pipe(duplex=False)
        child = multiprocessing.get_context("fork").Process(
            target=attempt, args=(target.name, number, seconds, known, theirs)
        )
        child.start()
        theirs.close()
        what = "begins"
        try:
            while what != "ended":
                if not ours.poll(4 * SECONDS + 20):
                    self._failed(target, number, f"TooSlow: it does not end within {4 * SECONDS + 20:g} s")
                    break
                what, number, why = ours.recv()
                if what == "failed":
                    self._failed(target, number, why)
        except EOFError:
            child.join()
            self._failed(target, number, f"Crash: its process ended with {child.exitcode}")
        if child.is_alive() and what != "ended":
            child.kill()
        child.join()
        self.next[target.name] = number + (what != "ended")

    def _failed(self, target: Target, number: int, why: str) -> None:
        if kind(why) in self.kinds[target.name]:
            return
        self.kinds[target.name].add(kind(why))
        self.failures += 1
        print(f"{target.name}: input {number}: {why}", flush=True)
        data, ends = target.input(number), why.startswith(("Crash", "TooSlow: it does not", "MemoryError"))
        if not ends:
            data = reduced(target, data, why)
        path = FOUND / f"{target.name}-{sha256(data).hexdigest()[:12]}"
        FOUND.mkdir(exist_ok=True)
        path.write_bytes(data)
        print(f"{target.name}: written to {os.path.relpath(path)} ({len(data)} bytes)", flush=True)


def main() -> int:
    """Try readers for some time; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="how long, of all readers together (60)")
    parser.add_argument("--target", nargs="+", choices=sorted(BY_NAME), metavar="NAME", help=", ".join(BY_NAME))
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="number of the first input of each reader (0)")
    parser.add_argument("--input", type=int, metavar="N", help="write this input of the reader to standard output")
    arguments = parser.parse_args()
    chosen = [BY_NAME[name] for name in arguments.target or BY_NAME]
    if arguments.input is not None:
        sys.stdout.buffer.write(chosen[0].input(arguments.input))
        return 0
    for target in [target for target in chosen if not all(map(find_spec, target.needs))]:
        print(f"{target.name}: NOT TRIED: needs {', '.join(target.needs)}")
        chosen.remove(target)
    begun, until = time.monotonic(), time.monotonic() + 60 * arguments.minutes
    fuzzing = Fuzzing(arguments.seed)
    while chosen and time.monotonic() < until:
        for target in chosen:
            left = until - time.monotonic()
            if left > 0:
                fuzzing.round(target, min(ROUND, left, 60 * arguments.minutes / len(chosen)))
        tried = sum(number - arguments.seed for number in fuzzing.next.values())
        print(f"{(time.monotonic() - begun) / 60:.1f} min: {tried} inputs, {fuzzing.failures} failures", flush=True)
    for target in TARGETS:
        if target.name in fuzzing.next:
            print(f"{target.name:16} {fuzzing.next[target.name] - arguments.seed:8} inputs")
    return min(1, fuzzing.failures)


if __name__ == "__main__":
    sys.exit(main())
