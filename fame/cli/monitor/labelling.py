"""``fame monitor label`` and ``fame monitor retrain``: what people say of runs goes into the next training."""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import fields
from getpass import getuser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, command
from fame.cli.monitor.models import add_inputs, read_for
from fame.cli.network import person
from fame.cli.output import note, table
from fame.errors import ConfigError

if TYPE_CHECKING:
    from fame.monitor.pipeline.train import Training
    from fame.monitor.pipeline.trained_model import TrainedModel


_LABEL_EXAMPLES = (
    "fame monitor label monday.csv:3 --benign --model joint_monitor.skops",
    "fame monitor label monday.csv:3 --remove --model joint_monitor.skops",
    "fame monitor label run.mcap --benign --model joint_monitor.skops --config low_pass.yaml --namespace Arm",
)


def add_label(commands: Commands) -> None:
    parser = command(
        commands, "label", run_label,
        examples=_LABEL_EXAMPLES,
        help="say what recorded runs are, such as that an alarm was false; the next training of the model uses it",
    )  # fmt: skip
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="RUN",
        help="file with its runs, or one of them: runs.csv:3; of a bag, the table is kept beside the model",
    )
    label = parser.add_mutually_exclusive_group(required=True)
    label.add_argument("--benign", dest="label", action="store_const", const="benign", help="it trains")
    label.add_argument("--anomalous", dest="label", action="store_const", const="anomalous", help="it does not train")
    label.add_argument("--remove", dest="label", action="store_const", const="",
                       help="take back what was said, also of a file that is gone")  # fmt: skip
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL.skops", help="beside which that is stored")
    add_inputs(parser)
    parser.add_argument("--by", metavar="NAME", help="who says so (default: the user)")


def run_label(arguments: Namespace) -> int:
    """Store what is said of runs, or take it back."""
    from fame.monitor.labels import remove_labels, table_beside

    found = [re.fullmatch(r"(.+):(\d+)", text) or (text, text, "") for text in arguments.runs]
    named = [(each[1], each[2] and str(int(each[2]))) for each in found]
    if not arguments.label:
        count = remove_labels(arguments.model, [(str(table_beside(arguments.model, file)), run) for file, run in named])
        print(f"{count} {'label' if count == 1 else 'labels'} removed: fame monitor retrain {arguments.model}")
        return 0
    count = label(arguments.model, named, arguments.label, arguments.by or getuser(), arguments)
    print(f"{count} {arguments.label} {'run' if count == 1 else 'runs'}: fame monitor retrain "
          f"{arguments.model} uses what is said")  # fmt: skip
    return 0


def label(path: Path, named: Sequence[tuple[str, str]], label: str, who: str, arguments: Namespace) -> int:
    """Store what somebody says of runs, each a file and a number (empty: all of the file), beside a model. Returns of
    how many. Raises ConfigError."""
    from fame.monitor.labels import add_labels
    from fame.monitor.pipeline.trained_model import TrainedModel

    model, chosen = TrainedModel.load(path), []
    for file, number in named:
        runs = list(enumerate(read_for(model, [_table(path, file, model, arguments)], arguments)))
        if number and int(number) >= len(runs):
            raise ConfigError(f"has no run {number}; it has {len(runs)}, from 0 on", file=file)
        chosen += [runs[int(number)]] if number else runs
    add_labels(path, chosen, label, who)
    return len(chosen)


def _table(path: Path, file: str, model: TrainedModel, arguments: Namespace) -> Path:
    """Return the table of a run, which the next training reads: of a bag one that is written beside the model."""
    from fame.monitor.labels import table_beside
    from fame.monitor.pipeline.recording import RecordingOptions, tables_of
    from fame.text import write_file

    kept = table_beside(path, file)
    if kept != Path(file) and arguments.config is not None:
        options = RecordingOptions(namespace=arguments.namespace, elements=bool(model.elements), report=note)
        with tables_of([file], arguments.config, options) as tables:
            kept.parent.mkdir(exist_ok=True)
            write_file(kept, Path(tables.paths[0]).read_bytes())
        return kept
    return Path(file)


def label_on_page(path: Path, recording: Path, arguments: Namespace, command: Mapping[str, Any]) -> dict[str, Any]:
    """Say for a page, and for who uses it, that a run of a recording was benign. Raises ConfigError."""
    run = command.get("run")
    if not isinstance(run, int) or isinstance(run, bool) or run < 0:
        raise ConfigError(f"expected the number of a run, got {run!r}")
    label(path, [(str(recording), str(run))], "benign", str(command.get("who") or person()), arguments)
    return {"said": f"The run is benign: fame monitor retrain {path} uses that."}


def add_retrain(commands: Commands) -> None:
    parser = command(
        commands, "retrain", run_retrain, examples=("fame monitor retrain joint_monitor.skops",),
        help="train a model again on its runs and those with labels: what changes in thresholds and verdicts",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.skops")
    parser.add_argument("--data", nargs="+", default=[], metavar="FILE", help="runs, instead of those of its training")
    parser.add_argument("--keep", action="store_true", help="as in fame monitor train")


def run_retrain(arguments: Namespace) -> int:
    """Train again as before, and say what changed in thresholds and in verdicts on the runs with labels."""
    from fame.cli.monitor.pipelines import store_trained
    from fame.monitor.judge import judge_trained
    from fame.monitor.labels import labelled_runs
    from fame.monitor.pipeline.trained_model import TrainedModel

    path = arguments.model
    old = TrainedModel.load(path)
    config = _settings(old, arguments.data, path)
    more = Namespace(output=path, check=False, compare=False, keep=arguments.keep, onnx=None, plots=None, json=False)
    store_trained(more, config, str(path), config.files, lambda runs, columns: runs)
    new = TrainedModel.load(path)
    pairs = zip(old.columns, old.thresholds, new.thresholds, strict=True)
    print(f"\n{table(('threshold of', 'before', 'now'), [(n, f'{a:.4g}', f'{b:.4g}') for n, a, b in pairs])}")
    runs = labelled_runs(path, old.columns, config.special)
    before, now = (judge_trained(model, [run for _, run in runs], "").runs for model in (old, new))
    rows = [
        (
            f"{Path(each['file']).name}:{each['run']}",
            each["label"],
            f"{each['who']}, {each['when']}",
            a.verdict,
            b.verdict,
        )
        for (each, _), a, b in zip(runs, before, now, strict=True)
    ]
    if rows:
        print(f"\n{table(('run', 'label', 'said by', 'before', 'now'), rows)}")
    return 0


def _settings(model: TrainedModel, data: Sequence[str], path: Path) -> Training:
    """Return the settings of the training of a model, on its files or on `data`. Raises ConfigError."""
    from fame.monitor.data_files import is_bag
    from fame.monitor.pipeline.join import Join
    from fame.monitor.pipeline.run_trigger import RunTrigger
    from fame.monitor.pipeline.train import Training

    stored, known = model.conditions.get("settings", {}), {each.name for each in fields(Training)}
    files = tuple(map(str, data)) or tuple(model.conditions.get("paths", ()))
    if not files or any(is_bag(Path(each)) for each in files):
        text = "does not know the tables of its training: expected --data FILE, or fame monitor train as before"
        raise ConfigError(text, file=str(path))
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in stored.items() if name in known
    }
    given |= {"join": Join(*stored["join"])} if stored.get("join") else {}
    given |= {"run": RunTrigger(*stored["run"])} if stored.get("run") else {}
    given |= {"detector": ""} if "chosen" in model.conditions else {}
    return Training(**{**given, "files": files, "model": str(path)})
