"""``fame campaign``: many runs of a scenario with other seeds, values, faults and networks, and their statistics."""

from __future__ import annotations

import shlex
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_json, add_library, command, natural, positive, whole
from fame.cli.output import note, print_json, progress_line
from fame.errors import ConfigError, FameError
from fame.rooms import WRITE_RECORDING, load

if TYPE_CHECKING:
    from fame.campaign.runs import Campaign, Folder

_EXAMPLES = (
    "fame campaign examples/ground_vehicles.yaml --runs 200",
    "fame campaign examples/agriculture.yaml --runs 1000 --vary examples/campaign.yaml -o out/campaign",
    "fame campaign --resume out/campaign",
)
_count = whole("a whole number from 1 on", 1)


def add(commands: Commands) -> None:
    parser = command(commands, "campaign", run, examples=_EXAMPLES)
    parser.add_argument(
        "scenario", nargs="?", type=Path, metavar="SCENARIO.yaml|MODEL.bpmn",
        help="without it, the first scenario of the project (fame.yaml)",
    )  # fmt: skip
    parser.add_argument("--runs", type=_count, default=100, metavar="N", help="number of runs (100)")
    parser.add_argument("--vary", type=Path, metavar="CAMPAIGN.yaml", help="values that vary, besides the seed")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for rows and reports (out/campaign)")
    parser.add_argument(
        "--record",
        action="store_true",
        help="record each run in the folder: for heat maps (fame view DIR), and a page of each cause of failures",
    )
    parser.add_argument("--resume", type=Path, metavar="DIR", help="continue the campaign of a folder")
    parser.add_argument("--seed", type=natural, default=1, metavar="N", help="seed of the first run (1)")
    parser.add_argument("--duration", type=positive, metavar="S", help="simulated seconds after which a run ends")
    parser.add_argument(
        "--width",
        type=positive,
        metavar="W",
        help="stop when the 95 %% interval of the success rate is narrower, as in 0.02",
    )
    parser.add_argument(
        "--property", metavar="NAME", help="with --width: that of the probability that this property is violated"
    )
    parser.add_argument("--jobs", type=_count, metavar="N", help="number of parallel runs (all cores)")
    parser.add_argument(
        "--backend", choices=("loky", "dask", "ray"), default="loky",
        help="backend of joblib: processes on this machine (loky, the default), or a cluster at --address",
    )  # fmt: skip
    parser.add_argument(
        "--address", default="", metavar="URL", help="address of the cluster's scheduler, such as tcp://127.0.0.1:8786"
    )
    parser.add_argument("--parquet", action="store_true", help="write runs.parquet instead of runs.csv")
    add_library(parser)
    add_json(parser)


_FOLDER = Path("out/campaign")
_OF_RESUMED = ("resume", "jobs", "width", "property", "parquet", "json", "no_project")
"""Options of a campaign that goes on; all others are kept with it."""


def run(arguments: Namespace) -> int:
    """Do the runs, write the reports, and print what they say."""
    from fame.campaign.report import interval, summary, text_report, write_reports
    from fame.campaign.runs import run_campaign
    from fame.imports import require

    require("joblib", "matplotlib", "scipy")  # before a folder is written, which would be in the way
    if arguments.property is not None and arguments.width is None:
        raise ConfigError("--property needs --width W")
    campaign, folder = _campaign(arguments)
    interrupted = False
    with progress_line(sys.stderr, wanted=not arguments.json) as line:

        def show(rows: list[dict[str, Any]]) -> None:
            if line is not None:
                done = sum(row["status"] == "completed" for row in rows)
                line.write(f"{len(rows)} of {campaign.runs} runs, {done} completed", len(rows) / campaign.runs)

        try:
            rows = run_campaign(campaign, folder, width=arguments.width, property=arguments.property, progress=show)
        except KeyboardInterrupt:
            interrupted, rows = True, folder.rows()
    if not rows:
        print(_goes_on(folder), file=sys.stderr)
        return 130
    pages = _pages(rows, folder.path)
    written = write_reports(rows, folder.path, campaign.scenario, parquet=arguments.parquet, pages=pages)
    found = summary(rows)
    if arguments.json:
        print_json({"status": "interrupted" if interrupted else "completed", **found, "files": list(map(str, written))})
    else:
        print("\n".join(text_report(rows)))
        print("\n".join(map(str, written)))
        if interrupted:
            print(_goes_on(folder))
    if interrupted:
        return 130
    if all(row["status"] == "impossible" for row in rows):  # nothing was measured
        return 1
    low, high = interval(rows, property=arguments.property)
    wide = arguments.width is not None and high - low > arguments.width
    if wide:
        note(f"fame: after all runs the interval is {high - low:.3f} wide: more than --width {arguments.width:g}")
    return 3 if wide or found["not_known"] else 0


_MOST = 20
"""Causes of failures whose run gets a page: those of most runs."""


def _pages(rows: list[dict[str, Any]], folder: Path) -> dict[int, str]:
    """Write a page of the shortest run of each cause of failures, if it was recorded. Returns their names, by run."""
    from fame.campaign.report import causes

    pages = {}
    for run in (cause["run"] for cause in causes(rows)[:_MOST]):
        recording = folder / f"run-{run}.mcap"
        if recording.exists():
            try:
                load(WRITE_RECORDING)(recording.with_suffix(".html"), recording)
            except FameError as error:  # of a run that crashed; or without the room
                note(f"fame: no page of run {run}: {error}")
            else:
                pages[run] = f"{recording.stem}.html"
    return pages


def _goes_on(folder: Folder) -> str:
    return f"interrupted; to continue: fame campaign --resume {shlex.quote(str(folder.path))}"


def _campaign(arguments: Namespace) -> tuple[Campaign, Folder]:
    """The campaign and the folder of its results. Raises ConfigError and ModelError before the first run."""
    from fame.campaign.runs import Campaign, Folder
    from fame.campaign.variation import Variation, read_variation

    if arguments.resume is not None:
        if arguments.scenario is not None:
            raise ConfigError("expected a scenario or --resume DIR, got both")
        folder = Folder(arguments.resume)
        campaign = folder.campaign()
        for action, _ in arguments.leaf.given:
            if action.dest not in _OF_RESUMED:
                text = f"--resume continues a campaign as it began: {action.option_strings[-1]} is for a new one"
                raise ConfigError(text, file=str(folder.path))
        folder.check_files(campaign)
        campaign.check_property(arguments.property)
        return replace(campaign, workers=arguments.jobs or campaign.workers), folder
    if arguments.scenario is None:
        raise ConfigError("expected a scenario, or --resume DIR (see fame campaign --help)")
    if arguments.backend != "loky" and not arguments.address:
        raise ConfigError(f"--backend {arguments.backend} needs --address of the scheduler")
    project = arguments.project
    whole = project is not None or arguments.backend != "loky"  # the commands of its rows work from any folder
    campaign = Campaign(
        scenario=str(arguments.scenario.resolve() if whole else arguments.scenario),
        runs=arguments.runs,
        seed=arguments.seed,
        variation=read_variation(arguments.vary) if arguments.vary is not None else Variation(),
        duration=arguments.duration,
        library=tuple(str(path.resolve() if whole else path) for path in arguments.library),
        types=tuple(str(path.resolve() if whole else path) for path in arguments.types),
        project=str(project.file) if project is not None else "",
        workers=arguments.jobs or -1,
        backend=arguments.backend,
        address=arguments.address,
        record=str((arguments.output or _FOLDER).resolve()) if arguments.record else "",
    )
    campaign.check()
    campaign.check_property(arguments.property)
    campaign.jobs()
    folder = Folder(arguments.output or _FOLDER)
    folder.begin(campaign)
    return campaign, folder
