"""``fame train``: autoencoders from recorded runs."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, add_json, command
from fame.cli.output import print_json, table


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "train", run, examples=("fame train monitor.yaml", "fame train monitor.yaml --onnx monitor.onnx"),
        help="train an autoencoder per channel on recorded runs, and set its thresholds from runs held back",
    )  # fmt: skip
    parser.add_argument("configuration", type=Path, metavar="CONFIG.yaml", help="a configuration with Training")
    parser.add_argument("-o", "--output", type=Path, metavar="MODEL.skops", help="instead of the configuration's Model")
    parser.add_argument("--onnx", type=Path, metavar="MODEL.onnx", help="write the model as ONNX too")
    parser.add_argument("--check", action="store_true", help="only look whether the stored model is of these data")
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Train, store, and tell how it went."""
    from dataclasses import asdict

    from fame.errors import ConfigError
    from fame.imports import require
    from fame.monitor.data_files import hash_files
    from fame.monitor.pipeline.configuration import load
    from fame.monitor.pipeline.train import train, training_of
    from fame.monitor.pipeline.trained_model import TrainedModel

    if arguments.onnx is not None:
        require("onnx")
    configuration = load(arguments.configuration)
    file = str(configuration.file)
    if configuration.training is None:
        text = "has no section Training; expected Training: {Files: [runs.csv], Model: model.skops}"
        raise ConfigError(text, file=file)
    training = training_of(configuration.training, configuration.folder)
    path = arguments.output or Path(training.model)
    if arguments.check:
        model = TrainedModel.load(path, columns=training.columns, data=hash_files(training.files))
    else:
        model = train(training)
        model.save(path)
    if arguments.onnx is not None:
        model.save(arguments.onnx)
    if arguments.json:
        told = {"model": str(path), "columns": model.columns, "data": model.data, "rate": model.rate}
        settings = {name: value for name, value in asdict(training).items() if name not in ("model", "columns")}
        print_json({"status": "completed", **told, "thresholds": model.thresholds, "metrics": dict(model.metrics),
                    "versions": dict(model.versions), "training": settings})  # fmt: skip
        return 0
    kinds = ("training_mean", "training_max", "validation_mean", "validation_max")
    figures = zip(*(model.metrics[kind] for kind in kinds), model.thresholds, strict=True)
    rows = [(name, *(f"{value:.4g}" for value in row)) for name, row in zip(model.columns, figures, strict=True)]
    print(table(("loss of", "training mean", "maximum", "held back mean", "maximum", "threshold"), rows))
    layers = "-".join(map(str, model.network.layers))
    print(f"\n{path}: {layers} per channel, windows of {model.window} samples at {model.rate:.4g} Hz, "
          f"data {model.data[:12]}")  # fmt: skip
    return 0
