"""A campaign: many runs of one scenario with other seeds, values, faults and networks.

Each run is a `Job`, done in a process of joblib's (on all cores, or on a cluster by joblib's backends), and gives a row
of plain data. Rows are written as they come, to ``runs.jsonl`` in the folder of the campaign, so that a campaign that
was interrupted can go on.
"""

from __future__ import annotations

import ast
import hashlib
import json
import math
import shlex
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fame.campaign.properties import columns
from fame.campaign.variation import FAULTS, Distribution, Variation, points
from fame.check.variables import parameters, variable_names
from fame.dataclasses import asdict, dataclass, field
from fame.errors import ConfigError, FameError, display_name
from fame.imports import require
from fame.properties.conditions import measured
from fame.scenario.plan import Fault, changed, named_files, read_scenario
from fame.scenario.run import Run
from fame.scenario.scenario import Scenario
from fame.scenario.settings import ALL
from fame.text import suggestion

if TYPE_CHECKING:
    from fame.bpmn.model import Process
    from fame.robot.events import Observer

ROWS, ABOUT = "runs.jsonl", "campaign.json"
_FILES = "files"
"""Key of the campaign's description with the SHA-256 of its files as it began."""
_Row = dict[str, Any]
_ATTEMPTS = 3
"""Number of attempts of a run whose process dies."""
_BATCH = 8
"""Runs for each process between two looks at whether it is enough."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run. `changes` by path of the scenario; `measures` are expressions over the variables of each robot.

    `record` is the folder for its recording (``run-NUMBER.mcap``), if one is wanted.
    """

    number: int
    scenario: str
    seed: int
    changes: Mapping[str, Any] = field(default_factory=dict)
    measures: Mapping[str, str] = field(default_factory=dict)
    duration: float | None = None
    library: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    project: str = ""
    record: str = ""

    def command(self) -> str:
        """Return the command that repeats this run."""
        words = ["fame", "run", self.scenario, "--seed", str(self.seed)]
        for path, value in self.changes.items():
            if path == FAULTS:
                words += [word for one in _fault_texts(value) for word in ("--fault", one)]
            else:
                words += ["--change", f"{path}={json.dumps(value)}"]
        if self.duration is not None:
            words += ["--duration", f"{self.duration:g}"]
        words += [word for folder in self.library for word in ("--library", folder)]
        words += [word for folder in self.types for word in ("--types", folder)]
        words += ["--no-project"] if self.project else []
        return shlex.join(words)

    def head(self) -> _Row:
        """Return what its row begins with, however it ends."""
        return {"run": self.number, "seed": self.seed, "command": self.command(), "changes": dict(self.changes)}


def run_job(job: Job) -> _Row:
    """Execute a run and return its row. An impossible world is a status, not an error."""
    from fame.middleware.messages import register_files

    for folder in job.types:
        register_files(folder)
    row = job.head()
    with ExitStack() as opened:
        try:
            changes = {path: value for path, value in job.changes.items() if path != FAULTS}
            scenario = Scenario.load(
                job.scenario,
                seed=job.seed,
                duration=job.duration,
                library=job.library,
                faults=[*map(Fault.of, _fault_texts(job.changes.get(FAULTS)))],
                changes=changes,
            )
            log = opened.enter_context(_recording(job, scenario)) if job.record else None
            run = Run(scenario, False, log, None)
        except FameError as error:
            return {**row, "status": "impossible", "cause": str(error)}
        driven = _Distances(run.world) if run.world is not None else None
        result = run.result()
    variables = {
        node.name: _Variables(node.instances[-1].variables) if node.instances else _Variables({}) for node in run.nodes
    }
    world = result.world or {}
    return {
        **row,
        "status": result.status,
        "cause": cause_of(result),
        "duration": round(result.simulated, 6),
        "wall": round(result.wall, 3),
        "distance": round(driven.total, 3) if driven is not None else None,
        "collisions": len(world.get("collisions", ())),
        "lost": sum(run.network.lost.values()) if run.network is not None else 0,
        **{f"measure.{name}": _measured(text, variables) for name, text in job.measures.items()},
        **columns(result.judgements),
    }


def _recording(job: Job, scenario: Scenario) -> AbstractContextManager[Observer]:
    from fame.log import About, logging_to

    return logging_to(
        Path(job.record, f"run-{job.number}.mcap"), scenario.closures(), About(metadata={"seed": str(job.seed)})
    )


class _Distances:
    """The way that all robots of a world have gone together (m), by their places every tenth step."""

    def __init__(self, world: Any) -> None:
        self.total = 0.0
        self._bodies = [robot.body for robot in world.robots.values() if getattr(robot, "body", None) is not None]
        self._last = [tuple(body.position) for body in self._bodies]
        self._steps = 0
        world.watchers.append(self._look)

    def _look(self, _: object) -> None:
        self._steps += 1
        if self._steps % 10 == 0:
            places = [tuple(body.position) for body in self._bodies]
            self.total += sum(map(math.dist, self._last, places))
            self._last = places


class _Variables:
    """The variables of a robot as attributes, for expressions such as ``REX.x_target``; none that was not measured."""

    def __init__(self, variables: Mapping[str, Any]) -> None:
        known = {name: value for name, value in variables.items() if value is None or measured(value) is not None}
        self.__dict__.update(known)


def _measured(text: str, variables: Mapping[str, _Variables]) -> Any:
    """The value of a measure; None if it cannot be computed: a variable was never set, or not measured (NaN)."""
    from fame.bpmn.model import Expression
    from fame.scripting import compile_expression

    try:
        value = compile_expression(Expression(text), file="measure", element="")(dict(variables))
    except Exception:
        return None
    return measured(value) if isinstance(value, bool | int | float | str) else None


def cause_of(result: Any) -> str:
    """Return the cause of a failed run: robot, element and code of the first error, else the
    robots that waited and where."""
    if result.status == "completed":
        return ""
    for robot in result.robots:
        for error in robot.errors:
            return f"{robot.name} failed at {display_name(error.element, error.name)}: {error.code or 'error'}"
    waits = [
        f"{wait.robot} waited at {wait.place or wait.element}" + (wait.suspended and ", ")
        + wait.suspended.partition(" since ")[0]
        for robot in result.robots for wait in robot.waits
    ]  # fmt: skip
    if result.never_started:
        return f"{', '.join(result.never_started)} never started" + (f"; {waits[0]}" if waits else "")
    untaken = [f"{robot.name} never took {topic}" for robot in result.robots for topic in robot.untaken]
    return "; ".join(dict.fromkeys((*waits[:2], *untaken[:1]))) or "not over"


def _fault_texts(value: Any) -> list[str]:
    """The faults of one run: a text, several, or none."""
    if value in (None, "", "none", False):
        return []
    return [str(one) for one in value] if isinstance(value, list) else [str(value)]


# ---- many runs -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """Many runs of a scenario. `workers` processes at a time (-1: all cores), on a `backend` of joblib.

    `library` and `types` are folders, beside those of the scenario; `project` is the file that named them, if one did.
    `record` is the folder for a recording of each run.
    """

    scenario: str
    runs: int
    seed: int = 1
    variation: Variation = field(default_factory=Variation)
    duration: float | None = None
    library: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    project: str = ""
    workers: int = -1
    backend: Literal["loky", "dask", "ray"] = "loky"
    address: str = ""
    record: str = ""

    def jobs(self) -> list[Job]:
        """Return all runs, in order. Raises ConfigError for a scenario or variation that is wrong."""
        yaml = Path(self.scenario).suffix.lower() in (".yaml", ".yml")
        world = read_scenario(Path(self.scenario)).world if yaml else None
        return [
            Job(
                number,
                self.scenario,
                self.seed + number - 1,
                values,
                self.variation.measures,
                self.duration,
                self.library,
                self.types,
                self.project,
                self.record,
            )
            for number, values in enumerate(points(self.variation, self.runs, self.seed, world), 1)
        ]

    def check(self) -> None:
        """Raise the error of a scenario, model or measure that is wrong for all values."""
        from fame.config.loader import read_document

        paths = [one.path for one in self.variation.distributions if one.path != FAULTS]
        if paths and Path(self.scenario).suffix.lower() in (".yaml", ".yml"):
            changed(read_document(self.scenario).data, dict.fromkeys(paths), self.scenario)
            Scenario.load(self.scenario, library=self.library, variables=_varied_variables(paths))
        choices = [choice for one in self.variation.distributions if one.path == FAULTS for choice in one.choices]
        faults = [Fault.of(text) for choice in choices for text in _fault_texts(choice)]
        loaded = Scenario.load(self.scenario, duration=self.duration, library=self.library, faults=faults)
        run = Run(loaded, False, None, None)
        run.close()
        if self.variation.measures:
            self._check_measures({robot: _variables_of(loaded, pool.process) for robot, pool in loaded.cast.items()})

    def _check_measures(self, robots: Mapping[str, Set[str] | None]) -> None:
        """`robots`: the variables of each; None: any."""
        from fame.bpmn.model import Expression
        from fame.scripting import compile_expression
        from fame.scripting.effects import effects_of
        from fame.scripting.python_effects import syntax_tree

        for name, text in self.variation.measures.items():
            expression, element = Expression(text), f"measure.{name}"
            compile_expression(expression, element=element)
            read, names = effects_of(expression).reads, ", ".join(sorted(robots))
            for other in sorted(read - robots.keys()):
                raise ConfigError(f"unknown robot {other}; robots are: {names}", element=element)
            if not read:
                raise ConfigError(f"expected variables of its robots ({names}), got {text}", element=element)
            for node in ast.walk(syntax_tree(expression) or ast.Module([], [])):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    robot, name = node.value.id, node.attr
                    if (known := robots.get(robot)) is not None and name not in known:
                        text = f"nothing sets {name} of {robot}; {suggestion(name, known)}"
                        raise ConfigError(text, element=element)

    def files(self) -> dict[str, str]:
        """Return the SHA-256 of the scenario, of what it names, and of the models, by file."""
        scenario = Scenario.load(self.scenario, library=self.library)
        contents = {one.file: one.source for one in scenario.closures()}
        for kind, path in named_files(Path(self.scenario)):
            if kind not in ("module", "models"):
                contents[str(path)] = path.read_bytes()
        return {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}

    def check_property(self, name: str | None) -> None:
        """Raise ConfigError if the scenario has no property of this name; None: of any name."""
        known = [each.name for each in Scenario.load(self.scenario, library=self.library).properties]
        if name is not None and name not in known:
            raise ConfigError(f"unknown property {name!r}; {suggestion(name, known)}", file=self.scenario)

    def rows(self, done: Sequence[int] = ()) -> Iterator[_Row]:
        """Execute the remaining runs, and yield their rows as they end."""
        pending = [job for job in self.jobs() if job.number not in done]
        if self.backend == "loky":
            yield from _local(pending, self.workers)
        else:
            yield from _on_cluster(pending, self.backend, self.address)


def _variables_of(scenario: Scenario, process: Process) -> Set[str] | None:
    """The variables that a process may have at its end; None: any."""
    definitions, library = scenario.definitions, scenario.library.declared
    names = variable_names(definitions, process.id, library)
    return names if names is None else names | parameters(definitions, process, library).keys()


def _varied_variables(paths: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The variables that are varied, by robot, as `Scenario.load` takes them; it refuses those that no model has."""
    by_robot: dict[str, dict[str, Any]] = {}
    for path in paths:
        match path.split("."):
            case ["variables", *robot, name] if len(robot) < 2:
                by_robot.setdefault(robot[0] if robot else ALL, {})[name] = None
    return by_robot


def _local(pending: Sequence[Job], workers: int) -> Iterator[_Row]:
    """Runs in processes of this machine. A process that dies takes its runs with it: they are tried again."""
    require("joblib")
    from joblib import Parallel, cpu_count, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    count = workers if workers > 0 else cpu_count()
    left = {job.number: job for job in pending}
    tried: dict[int, int] = {}
    while left:
        batch = list(left.values())[: count * _BATCH]
        alone = any(tried.get(job.number) for job in batch)
        batch = batch[:1] if alone else batch
        try:
            for row in Parallel(n_jobs=1 if count == 1 else count, return_as="generator_unordered", batch_size=1)(
                delayed(run_job)(job) for job in batch
            ):
                left.pop(row["run"])
                yield row
        except TerminatedWorkerError:
            for job in batch:
                if job.number in left:
                    tried[job.number] = tried.get(job.number, 0) + 1
                    if tried[job.number] >= _ATTEMPTS:
                        del left[job.number]
                        yield {**job.head(), "status": "crashed", "cause": f"the process died {_ATTEMPTS} times"}


def _on_cluster(pending: Sequence[Job], backend: str, address: str) -> Iterator[_Row]:
    """Runs on a cluster by a backend of joblib. Its scheduler tries runs again whose worker dies."""
    require("joblib")
    from joblib import Parallel, delayed, parallel_config

    with ExitStack() as opened:
        if backend == "dask":
            require("distributed")
            from distributed import Client

            client = opened.enter_context(Client(address))  # type: ignore[no-untyped-call]
            opened.enter_context(parallel_config(backend="dask", client=client))
        else:
            require("ray")
            import ray
            from ray.util.joblib import register_ray

            ray.init(address=address)
            register_ray()
            opened.enter_context(parallel_config(backend="ray"))
        for start in range(0, len(pending), 32 * _BATCH):
            yield from Parallel()(delayed(run_job)(job) for job in pending[start : start + 32 * _BATCH])


# ---- the folder of a campaign ----------------------------------------------------------------------------------------


class Folder:
    """The folder of a campaign: its description, and the rows of the completed runs."""

    def __init__(self, path: Path) -> None:
        self.path: Path = path

    def begin(self, campaign: Campaign) -> None:
        """Write the description of the campaign. Raises ConfigError if another one is in the folder."""
        if (self.path / ABOUT).exists():
            raise ConfigError(
                "has a campaign already; use --resume to continue it, or -o for another folder", file=str(self.path)
            )
        self.path.mkdir(parents=True, exist_ok=True)
        about = {**asdict(campaign), _FILES: campaign.files()}
        (self.path / ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")

    def _about(self) -> dict[str, Any]:
        try:
            about: dict[str, Any] = json.loads((self.path / ABOUT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise ConfigError(f"has no campaign: expected a file {ABOUT}", file=str(self.path)) from None
        return about

    def check_files(self, campaign: Campaign) -> None:
        """Raise ConfigError if a file of the campaign has changed since it began: its runs would not be of one mission.

        Nothing is known of one that an earlier version of FAME began.
        """
        before = self._about().get(_FILES)
        if before is None:
            return
        for name, digest in campaign.files().items():
            if digest != before.get(name):
                text = f"has changed since the campaign in {self.path} began: begin another one with -o"
                raise ConfigError(text, file=name)

    def campaign(self) -> Campaign:
        """Return the campaign of the folder. Raises ConfigError."""
        about = self._about()
        about.pop(_FILES, None)
        variation = about.pop("variation")
        distributions = tuple(
            Distribution(saved["path"], saved["kind"], tuple(saved["numbers"]), tuple(saved["choices"]))
            for saved in variation["distributions"]
        )
        about |= {name: tuple(about.get(name, ())) for name in ("library", "types")}
        return Campaign(
            **about, variation=Variation(distributions, variation["design"], dict(variation["measures"] or {}))
        )

    def rows(self) -> list[_Row]:
        """Return the rows of the completed runs; an incomplete line is ignored."""
        path = self.path / ROWS
        if not path.exists():
            return []
        by_run: dict[int, _Row] = {}
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except ValueError:
                continue
            by_run[row["run"]] = row
        return list(by_run.values())

    def add(self, row: _Row) -> None:
        with (self.path / ROWS).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def run_campaign(
    campaign: Campaign,
    folder: Folder,
    *,
    width: float | None = None,
    property: str | None = None,
    progress: Callable[[list[_Row]], object] = lambda rows: None,
) -> list[_Row]:
    """Do what is left of a campaign, until the interval of the success rate (or that of the probability that `property`
    is violated) is narrower than `width`, if given.

    Raises KeyboardInterrupt after Ctrl-C, and ConfigError if a script of the model fails in the very first run; what is
    done is in the folder. `progress` gets all rows after each run.
    """
    from fame.campaign.report import interval

    rows = folder.rows()
    runs = campaign.rows([row["run"] for row in rows])
    try:
        for row in runs:
            if row["status"] == "interrupted":  # Ctrl-C has reached the run itself: it is done again when resumed
                raise KeyboardInterrupt
            folder.add(row)
            rows.append(row)
            progress(rows)
            if len(rows) == 1 and row["cause"].endswith(": script"):
                raise ConfigError(_broken(row, folder))
            if width is not None and len(rows) >= 20:
                low, high = interval(rows, property=property)
                if high - low <= width:
                    break
    finally:
        with warnings.catch_warnings():  # joblib says that runs were cancelled, which is meant
            warnings.simplefilter("ignore", UserWarning)
            runs.close()  # type: ignore[attr-defined]
    return rows


def _broken(row: _Row, folder: Folder) -> str:
    go_on = f"fame campaign --resume {shlex.quote(str(folder.path))}"
    return f"a script fails in the first run: {row['cause']}; see {row['command']}; to continue nevertheless: {go_on}"
