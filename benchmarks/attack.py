"""Attacks on live engines, on real processes over DDS on loopback: each line says whether it held.

``python benchmarks/attack.py [NAME ...]`` makes all of them, or those that are named; exit code 1 if one had its
effect. Each is a function of a `Field` (`attacks.field`), in a process and a DDS domain of its own.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from attacks import deployment, engines, faults, network, people
from attacks.field import Fell, Field, NotRun

ATTACKS: tuple[Callable[[Field], None], ...] = (
    faults.half_killed,
    faults.fifty_over_zenoh,
    faults.stopped_sender,  # the longest first
    faults.stopped_first,
    faults.stopped_last,
    faults.bad_network,
    faults.redeployments,
    faults.flapping,
    faults.late_joiners,
    faults.two_splitters,
    engines.uninterruptible,
    deployment.strangers_key,
    deployment.silent_other,
    engines.large_model,
    network.signals_at_full_rate,
    network.cut_off_while_it_waits,
    network.clock_begins_anew,
    network.clock_far_ahead,
    deployment.sender_dies,
    deployment.bad_fields,
    deployment.forged_birth,
    deployment.forged_answers,
    engines.blanks,
    engines.computes_in_c,
    engines.endless_feel,
    engines.thread,
    engines.full_disk,
    engines.closed_pipe,
    engines.garbage,
    engines.large_tasks,
    engines.large_samples,
    people.odd_reports,
    people.stopped_engine,
    people.model_bomb,
)
ALONE = (faults.half_killed, faults.fifty_over_zenoh)
"""Made one at a time, before the others: their many engines need all processors of a small machine."""
PATIENCE, LONG_PATIENCE = 900, 7200
"""How long an attack may take (s), and with ``--long``."""
DOMAINS = 232
NOT_RUN = 77
"""The exit code of an attack that cannot be made here."""


def part(text: str) -> slice:
    """Read K/N: every Nth, from the Kth on."""
    number, _, count = text.partition("/")
    return slice(int(number) - 1, None, int(count))


def main() -> int:
    """Make attacks, some at a time; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(attack.__name__ for attack in ATTACKS))
    parser.add_argument("--jobs", type=int, default=3, metavar="N", help="how many at a time (3)")
    parser.add_argument(
        "--part", metavar="K/N", type=part, default=slice(None), help="the Kth of N parts of them, as 1/4"
    )
    parser.add_argument("--again", action="store_true", help="repeat an attack that fell, alone; twice counts")
    parser.add_argument("--long", action="store_true", help="redeployments: by 500 commands (a quarter of an hour)")
    parser.add_argument("--here", type=int, metavar="DOMAIN", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    chosen = [attack for attack in ATTACKS[arguments.part] if not arguments.names or attack.__name__ in arguments.names]
    if not chosen or len(chosen) < len(set(arguments.names)):
        parser.error("no such attack")
    if arguments.here is not None:
        return here(chosen[0], arguments.here, long=arguments.long)
    begun, make = time.monotonic(), partial(apart, long=arguments.long)
    chosen.sort(key=lambda attack: attack not in ALONE)
    large = sum(attack in ALONE for attack in chosen)
    verdicts = [make(attack, number) for number, attack in enumerate(chosen[:large])]
    with ThreadPoolExecutor(arguments.jobs) as pool:
        verdicts += pool.map(make, chosen[large:], range(large, len(chosen)))
    fell = [attack for attack, verdict in zip(chosen, verdicts, strict=True) if verdict == "fell"]
    if arguments.again:  # on a busy machine robots may need longer to meet than an attack waits
        fell = [attack for number, attack in enumerate(fell) if make(attack, len(chosen) + number) == "fell"]
    not_run = verdicts.count("NOT RUN")
    took = time.monotonic() - begun
    print(f"{len(chosen) - len(fell) - not_run} held, {len(fell)} fell, {not_run} NOT RUN, in {took:.0f} s")
    return min(len(fell), 1)


def apart(attack: Callable[[Field], None], number: int, *, long: bool) -> str:
    """Make one in a process of its own and print how it went: held, fell, or NOT RUN."""
    domain = 1 + (os.getpid() * 37 + number) % DOMAINS
    command = [sys.executable, __file__, attack.__name__, "--here", str(domain), *["--long"] * long]
    patience = LONG_PATIENCE if long else PATIENCE
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    begun = time.monotonic()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        out, err = process.communicate(timeout=patience)
    except subprocess.TimeoutExpired:
        process.terminate()  # its engines are its children, which it ends
        out, err = process.communicate()
        out = out or f"not over within {patience} s"
    what = str(attack.__doc__).splitlines()[0]
    reason = "" if process.returncode == 0 else out.strip() or err.strip()[-500:] or f"exit code {process.returncode}"
    took = f"{time.monotonic() - begun:5.1f} s"
    verdict = "NOT RUN" if process.returncode == NOT_RUN else "fell" if reason else "held"
    print(f"{verdict}  {took}  {attack.__name__:16} {what}{reason and f' >> {reason}'}", flush=True)
    return verdict


def here(attack: Callable[[Field], None], domain: int, *, long: bool) -> int:
    """Make one in this process; the exit code."""
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # which whoever runs the attacks may ignore, and engines then do
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that its engines are ended
    field = Field(domain, long=long)
    try:
        attack(field)
    except (Fell, NotRun) as effect:
        print(effect)
        return NOT_RUN if isinstance(effect, NotRun) else 1
    finally:
        field.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
