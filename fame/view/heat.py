"""The page of a folder of recordings: what the elements of each model did in all of them, as colours on its diagrams.

A model is a file with one content (its hash): runs of two versions are never counted together. Of the elements of a
called process all executions in that file count, whoever called it.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from fame.bpmn.model import Human
from fame.clock import SECOND
from fame.dataclasses import dataclass, field
from fame.deploy import model_hash
from fame.errors import ConfigError, FameError
from fame.intervals import nearest_rank
from fame.view.blocks import COLUMNS, Block
from fame.view.catalogue import NOWHERE, Catalogue
from fame.view.mission import mission_json
from fame.view.replay import Replay
from fame.view.state import ENTER, FAIL, LEAVE, TAKE
from fame.view.watch import FileWatch, Stamp, stamps_of


@dataclass(slots=True)
class ElementHeat:
    """What an element did in a run: executions begun (or flows taken), failures, the seconds of each completed one, and
    the seconds in which it, or something inside it, waited for a message, a person, a time, a condition or a join."""

    times: int = 0
    failures: int = 0
    seconds: list[float] = field(default_factory=list)
    waiting: float = 0.0

    def add(self, other: ElementHeat) -> None:
        """Count another run, too."""
        self.times, self.failures = self.times + other.times, self.failures + other.failures
        self.seconds += other.seconds
        self.waiting += other.waiting

    def to_json(self) -> dict[str, float | None]:
        """Return the numbers of a page: seconds as nearest ranks, None without a completed execution."""
        return {
            "times": self.times,
            "failures": self.failures,
            "p50": round(nearest_rank(self.seconds, 0.5), 3) if self.seconds else None,
            "p95": round(nearest_rank(self.seconds, 0.95), 3) if self.seconds else None,
            "waiting": round(self.waiting, 3),
        }


def heat_of(blocks: Sequence[Block], catalogue: Catalogue) -> dict[int, ElementHeat]:
    """Return what each element of a catalogue did in a run, by its number."""
    heat: defaultdict[int, ElementHeat] = defaultdict(ElementHeat)
    begun: defaultdict[tuple[int, int, int, int], list[int]] = defaultdict(list)
    waiting = _Waiting(heat, catalogue)
    for block in blocks:
        columns = block.columns  # of a stored block they are read
        for t, r, i, s, e, w in zip(*(columns[name] for name in COLUMNS), strict=True):
            if w in (ENTER, TAKE):
                heat[e].times += 1
            if w == ENTER:
                begun[r, i, s, e].append(t)
            elif w == FAIL:
                heat[e].failures += 1
            if ENTER < w <= FAIL and begun[r, i, s, e]:
                since = begun[r, i, s, e].pop(0)
                if w == LEAVE:
                    heat[e].seconds.append((t - since) / SECOND)
        waiting.read(block)
    waiting.end(blocks[-1].end if blocks else 0)
    heat.pop(NOWHERE, None)
    return dict(heat)


class _Waiting:
    """Adds how long elements wait to their `ElementHeat`: an activity waits while at least one token inside it does."""

    def __init__(self, found: Mapping[int, ElementHeat], catalogue: Catalogue) -> None:
        self._found, self._elements = found, catalogue.elements
        self._around: dict[tuple[int, int], tuple[int, list[int]]] = {}  # robot, scope -> scope around it, its openers
        self._tokens: dict[tuple[int, str], list[tuple[int, int, int]]] = {}  # robot, key -> robot, scope, element
        self._open: dict[tuple[int, int, int], list[int]] = {}  # place -> number of tokens, since when

    def read(self, block: Block) -> None:
        lists = block.lists
        for robot, scope, _, parent, openers, _ in (*block.key["scopes"], *lists["scopes"]):
            self._around[robot, scope] = parent, openers
        for time, robot, tokens, gone in lists["waits"]:
            for key in gone:
                self._close(robot, key, time)
            for token in tokens:
                if token["kind"] != "script" and (robot, token["key"]) not in self._tokens:
                    places = self._tokens[robot, token["key"]] = list(self._places(robot, token))
                    for place in places:
                        self._open.setdefault(place, [0, time])[0] += 1

    def end(self, time: int) -> None:
        for robot, key in tuple(self._tokens):
            self._close(robot, key, time)

    def _places(self, robot: int, token: Mapping[str, Any]) -> Iterator[tuple[int, int, int]]:
        """Where a token is, and the activities that it is inside are active."""
        scope = token["scope"]
        yield robot, scope, token["e"]
        while (robot, scope) in self._around:
            parent, openers = self._around[robot, scope]
            for opener in openers[::-1]:  # an event sub-process has its token in its own scope
                handles = getattr(self._elements[opener].element, "triggered_by_event", False)
                yield robot, scope if handles else parent, opener
            scope = parent

    def _close(self, robot: int, key: str, time: int) -> None:
        for place in self._tokens.pop((robot, key), ()):
            self._open[place][0] -= 1
            if not self._open[place][0]:
                self._found[place[2]].waiting += (time - self._open.pop(place)[1]) / SECOND


class _Place(NamedTuple):
    """An element of a file of the catalogue."""

    file: int
    id: str


_POLL = 1.0
"""Seconds between two looks at the folder."""


class HeatMap(FileWatch):
    """The source of the page of all recordings (.mcap) below a folder, which a thread reads: each once, and again when
    it has been written again. What each element did in all runs is summed as they are read, not as the page asks.

    `show` opens the page of one of them and gives its address. Raises ConfigError for a folder without recordings.
    """

    catalogue: Catalogue

    def __init__(self, folder: Path, show: Callable[[Path], str] | None = None) -> None:
        self._folder, self._show = folder, show
        self.paths: list[Path] = []
        self._run_of: dict[Path, int] = {}  # run: its place in paths
        self._stamps: dict[Path, Stamp] = {}  # of what was read
        if not self._stamped():
            text = (
                "has no recordings (.mcap): expected those of fame run --log, fame log record or fame campaign --record"
            )
            raise ConfigError(text, file=str(folder))
        self.catalogue = Catalogue([])
        self.notices: dict[int, list[str]] = {}  # run -> what is to be said of it
        self._numbers: dict[str, int] = {}  # hash -> number of the file
        self._missions: defaultdict[str, list[int]] = defaultdict(list)  # hash -> runs
        self._found: defaultdict[_Place, dict[int, ElementHeat]] = defaultdict(dict)
        self._sums: defaultdict[_Place, ElementHeat] = defaultdict(ElementHeat)
        self._shown: dict[_Place, dict[str, float | None]] = {}  # sums as JSON, until another run changes them
        self._pages: dict[int, str] = {}  # run -> address of its page
        self._left = 0  # recordings still to be read
        self._lock, self._settled = threading.Lock(), threading.Event()
        super().__init__()

    def wait(self) -> None:
        """Wait until everything that was there at first is read."""
        self._settled.wait()

    def _stamped(self) -> dict[Path, Stamp]:
        return stamps_of(sorted(self._folder.rglob("*.mcap")))

    def _watch(self) -> None:
        before, first = dict[Path, Stamp](), True
        while first or not self._closed.wait(_POLL):
            now = self._stamped()
            fresh = [path for path, stamp in now.items() if self._stamps.get(path) != stamp]
            if not first:  # what is being written is read when it is whole
                fresh = [path for path in fresh if before.get(path) == now[path]]
            for left, path in zip(range(len(fresh), 0, -1), fresh, strict=True):
                if self._closed.is_set():
                    break
                self._left, self._stamps[path] = left, now[path]
                self._read(path)
            before, first, self._left = now, False, 0
            self._version += bool(fresh)
            self._settled.set()

    def _read(self, path: Path) -> None:
        run = self._run_of.setdefault(path, len(self.paths))
        if run < len(self.paths):
            self._forget(run)
        else:
            self.paths.append(path)
        try:
            with Replay(path) as replay:
                replay.wait()
                self._add(run, replay)
        except FameError as error:
            self.notices[run] = [str(error)]
        except Exception as error:  # the others are read all the same
            self.notices[run] = [f"{self._name(run)}: it could not be read: {type(error).__name__}: {error}"]
        self._version += 1

    def _forget(self, run: int) -> None:
        """Take away what was read of a recording before."""
        with self._lock:
            for known in (self.notices, self._pages):
                known.pop(run, None)
            for runs in self._missions.values():
                runs[:] = [one for one in runs if one != run]
            for place, by_run in self._found.items():
                if by_run.pop(run, None) is not None:
                    del self._sums[place]
                    self._shown.pop(place, None)
                    for heat in by_run.values():
                        self._sum(place, heat)

    def _sum(self, place: _Place, heat: ElementHeat) -> None:
        self._sums[place].add(heat)
        self._shown.pop(place, None)

    def _add(self, run: int, replay: Replay) -> None:
        if not replay.blocks:
            self.notices[run] = [f"{self._name(run)}: nothing happened in it"]
            return
        heats, files = heat_of(replay.blocks, replay.catalogue), replay.catalogue.files
        hashes = [model_hash(each.source) for each in files]
        with self._lock:
            self.notices[run] = [f"{self._name(run)}: {text}" for text in replay.notices]
            fresh = {hash: each for hash, each in zip(hashes, files, strict=True) if hash not in self._numbers}
            self._numbers |= {hash: number for number, hash in enumerate(fresh, len(self._numbers))}
            self.catalogue.extend(list(fresh.values()))
            for file in replay.missions:
                self._missions[hashes[file]].append(run)
            for number, heat in heats.items():
                file, element, _ = replay.catalogue.elements[number]
                place = _Place(self._numbers[hashes[file]], element.id)
                self._found[place][run] = heat
                self._sum(place, heat)

    def _name(self, run: int) -> str:
        return str(self.paths[run].relative_to(self._folder))

    # ---- for the page ------------------------------------------------------------------------------------------------

    def mission(self) -> Mapping[str, Any]:
        version = self._version  # before the content: what is read in between is news
        with self._lock:
            runs, read = len(set().union(*self._missions.values())), len(self.paths)
            count = f"{runs} of {read} runs" if runs < read else f"{runs} runs"
            left = [f"{self._left} recordings are still to be read"] if self._left else []
            return mission_json(
                "model",
                self._folder.resolve().name,
                self.catalogue,
                (),
                chips=[(count, "", f"recordings below {self._folder}")],
                notices=[*left, *chain(*self.notices.values())],
                control=["runs", *(["show"] if self._show is not None else [])],
                heat=self._heat(),
                version=version,
                empty=["No model is read yet", "The page shows the recordings as they are read."],
            )

    def _heat(self) -> dict[str, Any]:
        for place in self._sums.keys() - self._shown.keys():
            self._shown[place] = self._sums[place].to_json()
        elements = {str(self.catalogue.number(*place)): one for place, one in self._shown.items()}
        models = [
            {"hash": hash, "name": Path(file.file).name, "runs": len(runs), "plane": self._plane(self._numbers[hash])}
            for hash, runs in self._missions.items()
            if runs
            for file in (self.catalogue.files[self._numbers[hash]],)
        ]
        return {"elements": elements, "models": sorted(models, key=lambda one: (one["name"], -one["runs"]))}

    def _plane(self, file: int) -> int:
        planes = self.catalogue.planes_json()
        return next((number for number, plane in enumerate(planes) if plane["of"] == file), NOWHERE)

    def plane(self, number: int) -> Mapping[str, Any]:
        with self._lock:
            return self.catalogue.plane_json(number)

    def tasks(self, element: str) -> list[Human]:
        return []

    def control(self, command: Mapping[str, Any]) -> Mapping[str, Any]:
        """``runs``: those of an element, by its number; ``show``: the address of the page of a run."""
        match command:
            case {"do": "runs", "element": int(number)} if 0 <= number < len(self.catalogue.elements):
                file, element, _ = self.catalogue.elements[number]
                with self._lock:
                    by_run = self._found.get(_Place(file, element.id), {}).items()
                    return {"runs": [{"run": run, "name": self._name(run), **one.to_json()} for run, one in by_run]}
            case {"do": "show", "run": int(run)} if self._show is not None and 0 <= run < len(self.paths):
                if run not in self._pages:
                    self._pages[run] = self._show(self.paths[run])
                return {"address": self._pages[run]}
        raise FameError("expected a run or an element of this page")
