"""Commands of learned models on recorded data: ``fame monitor judge`` and ``fame monitor model``."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import ROWS, Commands, Parser, add_json, add_rows, add_time_unit, command, group, namespace
from fame.cli.output import note, print_json, table
from fame.errors import NOT_KNOWN, ConfigError
from fame.text import percent, writable

if TYPE_CHECKING:
    from fame.monitor.anomaly.model import Model
    from fame.monitor.comparison import ModelComparison
    from fame.monitor.data_files import LabelledRun
    from fame.monitor.judge import Event, JudgedRuns
    from fame.monitor.pipeline.trained_model import TrainedModel

_JUDGE_EXAMPLES = (
    "fame monitor judge joint_monitor.skops runs.csv -o report.html",
    "fame monitor judge joint_monitor.skops run_bag --config low_pass.yaml --json",
    "fame monitor judge best.skops original_30.csv",
    "fame monitor judge best.skops recorded_bag --topic /Arm/joint_states -o report.html",
)


def add_judge(commands: Commands) -> None:
    parser = command(
        commands, "judge", run_judge, examples=_JUDGE_EXAMPLES,
        help="judge recorded runs by a model, with the same code as live: verdicts, events, rates, and a report",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.skops", help="what fame monitor train or adm learn wrote")
    _add_data(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="REPORT.html", help="write a page with plots")
    parser.add_argument(
        "--scores",
        type=Path,
        metavar="SCORES.csv",
        help="write the loss divided by the threshold, per time and channel",
    )
    add_json(parser)


def _add_data(parser: Parser) -> None:
    parser.add_argument("data", type=Path, nargs="+", metavar="DATA", help="CSV files, bags and MCAP files")
    add_inputs(parser)
    add_time_unit(parser, "as in training")
    add_rows(parser)


def add_inputs(parser: Parser) -> None:
    """``--config``, ``--topic`` and ``--namespace``: what is read of a bag."""
    parser.add_argument(
        "--config", type=Path, metavar="CONFIG.yaml",
        help="configuration whose Inputs are read from bags, for a model of fame monitor train",
    )  # fmt: skip
    parser.add_argument(
        "--topic", default="/joint_states",
        help="topic that is read from bags, for a model of fame monitor adm learn (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--namespace", type=namespace, default="", metavar="NAME", help="namespace of relative topics of --config"
    )


def run_judge(arguments: Namespace) -> int:
    """Judge; exit code 1 if a run is anomalous, otherwise 3 if one was not judged."""
    from fame.monitor.model_card import card_of, load_any

    for written in filter(None, (arguments.scores, arguments.output)):
        writable(written, arguments.model, *arguments.data)
    model = load_any(arguments.model)
    judgement = judged(model, arguments.model, arguments.data, arguments)
    if arguments.scores is not None:
        from fame.monitor.judge import write_scores

        write_scores(judgement, arguments.scores)
    if arguments.output is not None:
        from fame.monitor.judge_report import write_report

        write_report(judgement, card_of(model), arguments.output)
    if arguments.json:
        status = "partial" if judgement.exit_code == NOT_KNOWN else "completed"
        print_json({"status": status, **judgement.to_plain(), "report": str(arguments.output or "")})
    else:
        _print(judgement)
        if arguments.output is not None:
            note(f"report: {arguments.output}")
    return judgement.exit_code


def judged(model: TrainedModel | Model, path: Path, data: Sequence[Path], arguments: Namespace) -> JudgedRuns:
    """Let a model judge data, with `config`, `namespace` and `topic` of a command."""
    from fame.monitor.data_files import incomplete
    from fame.monitor.judge import judge_recordings, judge_trained
    from fame.monitor.pipeline.trained_model import TrainedModel

    if isinstance(model, TrainedModel):
        found = judge_trained(model, read_for(model, data, arguments), str(path))
    else:
        found = judge_recordings(model, data, str(path), arguments.topic)
    return found.cut_in(file for file in data if incomplete(file))


def judged_on_page(path: Path, recording: Path, arguments: Namespace) -> dict[str, Any]:
    """Let a model judge a recording: what the page of the recording shows of that. Raises ConfigError."""
    from fame.monitor.judge_report import on_page
    from fame.monitor.model_card import load_any

    note(f"judging {recording} by {path}")
    return on_page(judged(load_any(path), path, [recording], arguments))


def read_for(model: TrainedModel, paths: Sequence[Path], arguments: Namespace) -> list[LabelledRun]:
    """Read runs of CSV files and, by a configuration, of bags. Raises ConfigError."""
    from fame.monitor.data_files import ELEMENT, Special, check_blocks, is_bag, read_labelled_runs
    from fame.monitor.pipeline.join import Join
    from fame.monitor.pipeline.recording import RecordingOptions, tables_of
    from fame.monitor.pipeline.run_trigger import RunTrigger
    from fame.monitor.tables import RUN, STAMP

    settings = model.conditions.get("settings", {})
    names = (("time_column", STAMP), ("run_column", RUN), ("element_column", ELEMENT))
    unit = getattr(arguments, "time_unit", None) or settings.get("time_unit") or ""
    join = Join(*settings["join"]) if settings.get("join") else None
    trigger = RunTrigger(*settings["run"]) if settings.get("run") else None
    rows = {name: getattr(arguments, name, None) for name in ROWS}
    rows |= {name: settings.get(name) for name in ("rate", "anomaly_column", "benign") if rows[name] is None}
    rows["anomaly"] = rows.pop("anomaly_column")
    special = Special(*(settings.get(name, default) for name, default in names))._replace(
        unit=unit, join=join, trigger=trigger, **{name: value for name, value in rows.items() if value is not None}
    )
    options = RecordingOptions(namespace=arguments.namespace, elements=bool(model.elements), report=note)
    runs: list[LabelledRun] = []
    for path in paths:
        bag = is_bag(path)
        check_blocks(path, getattr(arguments, "benign", None) or "")
        if bag and arguments.config is None:
            text = "is not a CSV file: a bag needs --config CONFIG.yaml, whose Inputs name topics and fields"
            raise ConfigError(text, file=str(path))
        with tables_of([path], arguments.config, options) as tables:
            read = read_labelled_runs(
                tables.paths, model.columns, Special(join=join, trigger=trigger) if bag else special
            )
            runs += [run._replace(file=str(path)) for run in tables.completed(read, model.columns)]
    return runs


def _print(judgement: JudgedRuns) -> None:
    from fame.monitor.judge import shown

    rows = [
        (
            str(run.number), Path(run.file).name, run.verdict, f"{run.score:.3g}" if run.ratios.size else "-",
            f"{percent(run.share)} %", f"{run.seconds:.1f} s", "" if run.latency is None else f"{run.latency:.3g} s",
            "; ".join((*map(_event, [run.events] if run.events else []), *run.notes)),
        )
        for run in judgement.runs
    ]  # fmt: skip
    print(table(("run", "file", "verdict", "score", "judged", "length", "latency", "first event, notes"), rows))
    print()
    for name, value in judgement.figures.items():
        print(f"{name}: {shown(value)}")
    if judgement.drifting:
        print(f"drifting, learn again: {', '.join(judgement.drifting)}")
    for text in judgement.notes:
        note(text)


def _event(events: Sequence[Event]) -> str:
    more = f", {len(events)} events" if len(events) > 1 else ""
    return f"{events[0].start:.3f} s, {', '.join(events[0].shares)}{more}"


def add_model(commands: Commands) -> None:
    """Declare the command and its parts."""
    examples = "fame monitor model show joint_monitor.skops", "fame monitor model show best.skops --json"
    comparisons = ("fame monitor model compare old.skops new.skops runs.csv",)
    parser = group(commands, "model", examples=(*examples[:1], *comparisons), help="inspect and compare learned models")
    parts = parser.add_subparsers(metavar="SUBCOMMAND", required=True)
    show = command(
        parts, "show", run_show, examples=examples,
        help="show the card of a model: data, thresholds, promised and measured rates, limits",
    )  # fmt: skip
    show.add_argument("model", type=Path, metavar="MODEL.skops")
    add_json(show)
    compare = command(
        parts, "compare", run_compare, examples=comparisons,
        help="let two models judge the same recordings: exit code 1 if the new one judges more labelled runs wrongly, "
        "otherwise 3 if a run is not judged, or verdicts differ on runs without labels",
    )  # fmt: skip
    compare.add_argument("old", type=Path, metavar="OLD.skops")
    compare.add_argument("new", type=Path, metavar="NEW.skops")
    _add_data(compare)
    add_json(compare)


def run_show(arguments: Namespace) -> int:
    """Print the card."""
    from fame.monitor.model_card import card_of, load_any, to_markdown

    card = card_of(load_any(arguments.model))
    if arguments.json:
        print_json({"status": "completed", **card})
    else:
        print(to_markdown(card, arguments.model.name), end="")
    return 0


def run_compare(arguments: Namespace) -> int:
    """Compare; exit code 1 if the new model is worse, otherwise 3 if that is not known."""
    from fame.monitor.comparison import compared
    from fame.monitor.model_card import load_any

    paths = arguments.old, arguments.new
    models = [load_any(path) for path in paths]
    old, new = (judged(model, path, arguments.data, arguments) for model, path in zip(models, paths, strict=True))
    found = compared(old, new)
    if arguments.json:
        status = "partial" if found.exit_code == NOT_KNOWN else "completed"
        print_json({"status": status, **found.to_plain()})
    else:
        _print_comparison(found)
    return found.exit_code


def _print_comparison(compared: ModelComparison) -> None:
    from fame.monitor.judge import shown

    labels = {1: "benign", -1: "anomalous", None: "-"}
    if compared.differing:
        rows = [
            (str(old.number), Path(old.file).name, labels[old.label], old.verdict, new.verdict)
            for old, new in compared.differing
        ]
        print(table(("run", "file", "label", "old", "new"), rows))
        print()
    old, new = compared.old.figures, compared.new.figures
    print(
        table(("figure", "old", "new"), [(name, shown(old.get(name)), shown(new.get(name))) for name in {**old, **new}])
    )
    print(f"\n{compared.text}")
