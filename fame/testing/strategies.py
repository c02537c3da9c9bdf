"""Strategies of hypothesis: networks, faults, free places of a world, and messages of a type.

A property loads its mission with `load`, as a context: hypothesis calls the test many times, and each call needs a
mission of its own. A case that fails prints the command that does the run again.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis import note, strategies as st

from fame.campaign.variation import Distribution, free_places
from fame.errors import ConfigError
from fame.middleware import messages
from fame.middleware.network import Delay, Link, NetworkConfig, Partition
from fame.scenario import Fault
from fame.testing.mission import MissionLoader, MissionUnderTest

__all__ = ["faults", "load", "networks", "payloads", "places"]


@contextmanager
def load(path: str | Path, **options: Any) -> Iterator[MissionUnderTest]:
    """A mission for one case; options as of `MissionLoader.load`. Ends it after the block.

    A case that fails prints the command that does it again: ``fame run`` with the options, or ``fame test`` if the test
    uses stubs or fakes, sends or sets something; hypothesis keeps the case in its folder ``.hypothesis`` and tries it
    first. The run of the last failed case is saved in a folder for temporary files. A case that violates a property
    fails, unless the test has said that it expects that.
    """
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    name = "".join(sign if sign.isalnum() else "_" for sign in test.rpartition("::")[2])[:60]
    loader = MissionLoader(lambda: Path(tempfile.gettempdir()) / f"fame-case-{os.getpid()}-{name}")
    try:
        yield (mission := loader.load(path, **options))
        mission.check_properties()
    except BaseException:
        played = test and any(mission.is_played for mission in loader.loaded)
        note(f"repeat it with: {shlex.join(['fame', 'test', test]) if played else command(path, **options)}")
        raise
    finally:
        loader.close()


def command(path: str | Path, **options: Any) -> str:
    """Return the command that runs a mission with these options; stubs and fakes of the test are not part of it."""
    words = ["fame", "run", str(path)]
    if options.get("seed") is not None:
        words += ["--seed", str(options["seed"])]
    for fault in options.get("faults", ()):
        words += ["--fault", f"{fault.robot}@{fault.time:g}:{fault.kind}"]
    for robot, values in options.get("variables", {}).items():
        for name, value in values.items():
            words += ["--set", f"{robot + '.' if robot else ''}{name}={json.dumps(value)}"]
    for place, value in options.get("changes", {}).items():
        words += ["--change", f"{place}={json.dumps(value)}"]
    network: NetworkConfig | None = options.get("network")
    for link in network.links if network is not None else ():
        if not link.between and not link.topic and link.delay.kind == "fixed":
            words += ["--network-delay", f"{link.delay.first:g}", "--loss", f"{link.loss:g}"]
    for cut in network.partitions if network is not None else ():
        words += ["--partition", f"{','.join(cut.between)}@{cut.start:g}-{cut.end:g}"]
    return shlex.join(words)


def networks(
    *robots: str, delay: float = 0.5, loss: float = 0.2, partition: float = 0.0, until: float = 60.0
) -> st.SearchStrategy[NetworkConfig]:
    """Networks with delays up to `delay` s and losses up to `loss`.

    With `partition`, two of the robots are cut off from each other for up to `partition` simulated s, which begin
    before second `until`. Raises ConfigError if that names fewer than two robots.
    """
    links = st.builds(
        lambda seconds, share: (Link(Delay("fixed", seconds), share),), _tidy(0, delay), _tidy(0, min(loss, 0.99))
    )
    if not partition:
        return st.builds(NetworkConfig, links)
    if len(robots) < 2:
        raise ConfigError("networks: expected two robots or more to cut off, got " + (", ".join(robots) or "none"))
    pairs = st.lists(st.sampled_from(robots), min_size=2, max_size=2, unique=True)
    cuts = st.builds(
        lambda pair, start, length: (Partition((pair[0], pair[1]), start, round(start + length, 3)),),
        pairs,
        _tidy(0, until),
        _tidy(0.001, partition),
    )
    return st.builds(NetworkConfig, links, cuts)


def faults(*robots: str, kinds: Sequence[str] = ("engine",), until: float = 60.0) -> st.SearchStrategy[list[Fault]]:
    """No fault or one, of one of the robots, before simulated second `until`."""
    one = st.builds(Fault, st.sampled_from(robots), _tidy(0, until), st.sampled_from(list(kinds)))
    return st.lists(one, max_size=1)


def places(path: str | Path, of: str, *, clearance: float = 0.4) -> st.SearchStrategy[dict[str, Any]]:
    """Changes of a scenario that put a thing on free ground (m): ``of="world.robots.REX.at"``, for ``changes=``."""
    from fame.scenario.plan import read_scenario

    found = free_places(Distribution(of, "free", (clearance,)), read_scenario(Path(path)).world)
    return st.sampled_from(sorted(found)).map(lambda place: {of: list(place)})


def payloads(type: str, **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Messages of a type, whose numbers and texts vary; `fields` have strategies of their own.

    Numbers are whole and small; what hypothesis should explore further is given in `fields`. Raises MessageError for an
    unknown type or field.
    """
    default = messages.to_mapping(messages.create(type))
    for name in fields:
        if name not in default:
            messages.create(type, {name: 0})  # raises, and says which fields there are
    drawn = {name: fields[name] if name in fields else _like(value) for name, value in default.items()}
    return st.fixed_dictionaries(drawn).map(lambda values: messages.create(type, values))


def _like(value: Any) -> st.SearchStrategy[Any]:
    """Values of the kind of a field's default: lists stay as they are."""
    if isinstance(value, bool):
        return st.booleans()
    if isinstance(value, float):
        return st.integers(-1000, 1000).map(float)
    if isinstance(value, int):
        return st.integers(0, 100)
    if isinstance(value, str):
        return st.text("abcdefgh_", max_size=8)
    if isinstance(value, dict):
        return st.fixed_dictionaries({name: _like(one) for name, one in value.items()})
    return st.just(value)


def _tidy(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers with three digits behind the point, which a command line can repeat."""
    return st.integers(math.ceil(low * 1000), math.floor(high * 1000)).map(lambda number: number / 1000)
