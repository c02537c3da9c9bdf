"""Model cards: the data, promises and limits of a model, as Markdown and as JSON.

A card stands beside its model: ``joint_monitor.skops`` has ``joint_monitor.card.md`` and ``joint_monitor.card.json``.
All that it says is stored in the model, so that ``fame monitor model show`` needs the model alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from fame.errors import FameError
from fame.intervals import interval
from fame.monitor.calibration import FAR, measured_alarms
from fame.text import write_file

if TYPE_CHECKING:
    from fame.monitor.anomaly.model import Model
    from fame.monitor.calibration import Calibration
    from fame.monitor.pipeline.trained_model import TrainedModel

Card: TypeAlias = dict[str, Any]
"""Sections by title, each a mapping or a list of sentences; plain data."""


_EXCHANGEABLE = ("The promise holds for runs like those of the training: same task, speed, load, rate and sensors.",)


def load_any(path: str | Path) -> TrainedModel | Model:
    """Read a model of ``fame monitor train`` or ``adm learn``. Raises ConfigError for any other file."""
    from fame.monitor.anomaly.model import Model
    from fame.monitor.pipeline.trained_model import TrainedModel
    from fame.monitor.storage import read_model

    if Path(path).suffix == ".onnx":
        return TrainedModel.load(path)
    content = read_model(Path(path), "fame monitor train or adm learn")
    return Model.of(content, str(path)) if content.get("kind") == Model.kind else TrainedModel.of(content, str(path))


def origin_of(path: Path) -> dict[str, str]:
    """Return the date of a model that is stored now, and what it replaces."""
    found = {"made": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")}
    if not path.exists():
        return found
    try:
        old = load_any(path)
    except FameError:
        return found | {"predecessor": "a file that this version cannot read as a model"}
    made = old.conditions.get("made", "an unknown date")
    return found | {"predecessor": f"of {made}, trained on data {old.data[:12]}"}


def card_of(model: TrainedModel | Model) -> Card:
    from fame.monitor.pipeline.trained_model import TrainedModel

    return _of_windows(model) if isinstance(model, TrainedModel) else _of_points(model)


def _of_windows(model: TrainedModel) -> Card:
    from fame.monitor.pipeline.training_checks import warnings_of

    conditions, calibration = model.conditions, model.calibration
    window = f"{model.window / model.rate:.3g} s"
    promised = calibration is not None and calibration.promised is not None
    largest = model.metrics["training_max"]
    return {
        "Model": {
            "made by": model.maker, "made on": conditions.get("made"), "predecessor": conditions.get("predecessor"),
            "detector": model.detector_text, "channels": len(model.columns),
            "window": f"{model.window} samples, {window}", "rate": f"{model.rate:.4g} Hz",
        },
        "Data": {
            "sha256": model.data, "files": conditions.get("files", []), "runs": conditions.get("runs"),
            "samples": conditions.get("samples"), "seconds per run": conditions.get("seconds"),
        },
        "False alarms": _alarms(calibration, "trained by an earlier version"),
        "Thresholds": {
            name: f"{threshold:.4g} (largest in training: {most:.4g})"
            for name, threshold, most in zip(model.columns, model.thresholds, largest, strict=True)
        },
        **({"Would be found": _found(conditions["found"])} if conditions.get("found") else {}),
        "Limits": [
            *warnings_of(model), *(_EXCHANGEABLE if promised else ()),
            f"An anomaly shorter than a window ({window}) is averaged over it.",
        ],
        **({"Order of elements": [conditions["order_text"]]} if conditions.get("order_text") else {}),
        **({"Begin of a run": [conditions["begins_text"]]} if conditions.get("begins_text") else {}),
        "Settings": dict(conditions.get("settings", {})),
        "Versions": dict(model.versions),
    }  # fmt: skip


def _found(cases: Sequence[Sequence[Any]]) -> dict[str, str]:
    """Say of each kind of fault, put into left-out runs, what share was found at which size."""
    told: dict[str, list[str]] = {}
    for kind, size, found, tried in cases:
        share = f"{100 * found / tried:.0f} % of {tried}" if tried else "not tried"
        told.setdefault(kind, []).append(f"{share} ({size})")
    return {kind: "; ".join(shares) for kind, shares in told.items()}


def _of_points(model: Model) -> Card:
    from fame.monitor.anomaly.paths import PathDetector
    from fame.monitor.pipeline.detectors import Several
    from fame.monitor.pipeline.training_checks import drifting

    detector = type(getattr(model.detector, "classifier", model.detector)).__name__
    if isinstance(model.detector, Several):
        detector = f"{model.detector.rule} {', '.join(model.parts)}"
    return {
        "Model": {
            "made by": model.maker, "made on": model.conditions.get("made"),
            "predecessor": model.conditions.get("predecessor"), "detector": f"{model.name} ({detector})",
            "joints": ", ".join(model.joints), "usual run": f"{model.nominal} points",
        },
        "Data": {"sha256": model.data},
        "False alarms": _alarms(model.calibration, "learned without FalseAlarms"),
        "Threshold": {"score": model.threshold, "in points": model.alarm_text()},
        "Limits": [
            *_far_threshold(model.calibration), *drifting(model),
            "Points are scored against runs of the training: a changed task, load or speed needs a new model.",
            "Stamps are made up at the usual rate where messages have none.",
            *(
                part.limits_text() if isinstance(part, PathDetector)
                else f"{name} sees single points: their order and time do not count."
                for name, part in model.parts.items()
            ),
        ],
        "Versions": dict(model.versions),
    }  # fmt: skip


def _far_threshold(calibration: Calibration | None) -> list[str]:
    """Say so if a given threshold lies far above the scores of the runs that calibrated it."""
    if calibration is None or calibration.stretch[0] <= FAR:
        return []
    largest = float(calibration.scores.max())
    return [f"The given threshold lies far above the largest score of a left-out benign run ({largest:.4g})."]


def _alarms(calibration: Calibration | None, none: str) -> dict[str, Any]:
    """Describe what is promised; `none`: why nothing is, without a calibration."""
    if calibration is None:
        return {"promise": f"none: {none}"}
    return {
        "asked": f"{calibration.asked:g} per run", "promise": calibration.text,
        "promised per run": calibration.promised,
        "bound per run of 90 % of models": calibration.bound if calibration.promised is not None else None,
        "factor on thresholds": calibration.margin, **_measured(calibration),
    }  # fmt: skip


def _measured(calibration: Calibration) -> dict[str, Any]:
    """Return the rate of false alarms of the calibration's runs, each against the thresholds of the others."""
    if calibration.runs < 3:
        return {"measured": f"not with {calibration.runs} runs"}
    count = measured_alarms(calibration)
    low, high = interval(count, calibration.runs)
    return {
        "measured": f"{count} of {calibration.runs} runs, each against the thresholds of the others",
        "measured per run": count / calibration.runs,
        "95 % interval": [round(low, 4), round(high, 4)],
    }


def to_markdown(card: Card, title: str = "Model card") -> str:
    lines = [f"# {title}", ""]
    for name, section in card.items():
        if isinstance(section, Mapping):
            told = [f"- {key}: {_shown(value)}" for key, value in section.items() if value not in (None, "", [])]
        else:
            told = [f"- {sentence}" for sentence in section]
        lines += [f"## {name}", "", *told, ""] if told else []
    return "\n".join(lines)


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_shown, value))
    return str(value)


def write_card(model: TrainedModel | Model, path: str | Path) -> tuple[Path, Path]:
    """Write the card of a model beside its file, as Markdown and JSON; return both paths."""
    path, card = Path(path), card_of(model)
    markdown, data = (path.with_name(f"{path.stem}.card{ending}") for ending in (".md", ".json"))
    write_file(markdown, to_markdown(card, path.name))
    write_file(data, json.dumps(card, indent=2) + "\n")
    return markdown, data
