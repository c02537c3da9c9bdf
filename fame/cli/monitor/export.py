"""``fame monitor export``: a trained model as an ONNX file, which gives the same losses on the runs of its training."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fame.cli.arguments import Commands, add_json, command
from fame.cli.monitor.models import add_inputs, read_for
from fame.cli.output import print_json
from fame.errors import ConfigError
from fame.text import writable

if TYPE_CHECKING:
    from fame.monitor.pipeline.processor import Samples
    from fame.monitor.pipeline.trained_model import TrainedModel

_EXAMPLES = ("fame monitor export joint_monitor.skops -o joint_monitor.onnx",)


def add_export(commands: Commands) -> None:
    parser = command(
        commands, "export", run_export, examples=_EXAMPLES,
        help="write a model as an ONNX file, once that gives the same losses on the runs of its training",
    )  # fmt: skip
    parser.add_argument("model", type=Path, metavar="MODEL.skops", help="what fame monitor train wrote")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL.onnx")
    parser.add_argument("--single", action="store_true", help="inputs and outputs of 32 bit")
    parser.add_argument("--data", type=Path, nargs="+", metavar="FILE", help="runs, instead of those of its training")
    add_inputs(parser)
    add_json(parser)


def run_export(arguments: Namespace) -> int:
    """Write the file."""
    from fame.monitor.model_card import load_any
    from fame.monitor.pipeline.detectors import detector_name
    from fame.monitor.pipeline.trained_model import TrainedModel

    path, output = arguments.model, arguments.output
    model = load_any(path)
    if not isinstance(model, TrainedModel):
        text = "is a model of fame monitor adm learn, whose detectors have no form in ONNX"
        raise ConfigError(f"{text}; expected one of fame monitor train", file=str(path))
    files = arguments.data or [Path(each) for each in model.conditions.get("paths", ())]
    if not files or not (arguments.data or all(each.exists() for each in files)):
        text = "the runs of its training are not here, and it is exported only if it gives the same losses on runs"
        raise ConfigError(f"{text}: expected --data FILE", file=str(path))
    writable(output, path, *files)
    runs = [run.samples for run in read_for(model, files, arguments)]
    count, apart = export(model, runs, output, single=arguments.single)
    if arguments.json:
        names = [str(each) for each in files]
        print_json({"status": "completed", "output": str(output), "detector": detector_name(model.detector),
                    "data": names, "windows": count, "difference": apart})  # fmt: skip
    else:
        many = f"{len(runs)} {'run' if len(runs) == 1 else 'runs'}"
        print(f"{output}: {detector_name(model.detector)}; gives the losses of {path} on {count} windows of {many} "
              f"(largest difference {apart:.1g} of a threshold)")  # fmt: skip
    return 0


def export(model: TrainedModel, runs: Sequence[Samples], path: Path, *, single: bool = False) -> tuple[int, float]:
    """Write a model as an ONNX file, if that gives the same losses on runs. Returns the number of their windows and the
    largest difference, in units of the threshold. Raises ConfigError, UnavailableError without the packages."""
    from fame.imports import require
    from fame.monitor.pipeline.onnx_files import SAME, difference, onnx_bytes
    from fame.monitor.pipeline.train import Training, cut, prepared
    from fame.text import write_file

    require("onnx", "onnxruntime")
    writable(path)
    content = onnx_bytes(model, single=single)
    stride = model.conditions.get("settings", {}).get("stride", Training.stride)
    config = Training(before=model.before, window=model.window, stride=stride)
    windows, times = cut(prepared(runs, config), config, model.rate, model.elements)
    if (apart := difference(model, content, windows, times)) > SAME:
        text = f"gives other losses as ONNX: a difference of {apart:.2g} of a threshold on its runs; it is not written"
        raise ConfigError(text, file=str(path))
    write_file(path, content)
    return len(windows), apart
