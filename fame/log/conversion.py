"""Converts recordings to other logs: JSON Lines, CSV, XES and OCEL 2.0; merges recordings by time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from fame.bpmn.model import Definitions
from fame.clock import EPOCH, date_text
from fame.errors import ConfigError, ModelError
from fame.iso8601 import parse_datetime
from fame.log.elements import element_info
from fame.log.ocel import write_ocel
from fame.log.recording import Recording
from fame.log.writing import RECORDING, logging_to, new_file
from fame.robot.events import Event

OCEL = ".ocel.json"
FORMS: Sequence[str] = (".jsonl", ".csv", ".xes", OCEL)
"""What a recording can be converted to, by the end of the file's name."""

OnProgress = Callable[[float], object]
"""Takes how much is done, 0 to 1."""


def models_of(recording: Recording) -> list[Definitions]:
    """The models in a recording; those that cannot be read are left out."""
    from fame.bpmn import read_bytes

    found = []
    for name, data in recording.models.items():
        try:
            found.append(read_bytes(data, file=name))
        except ModelError:
            continue
    return found


def convert(source: str | Path, target: str | Path, on_progress: OnProgress = lambda done: None) -> None:
    """Convert a recording to the form that the name of the target says.

    Raises ConfigError for a name with another end, a file that is no recording, and one that cannot be written.
    """
    target = Path(target)
    if not target.name.lower().endswith(tuple(FORMS)):
        known = ", ".join(FORMS)
        raise ConfigError(f"expected a file name that ends in one of {known}, got {target.name!r}", file=str(target))
    with Recording(source) as recording:
        models = models_of(recording)
        if target.name.lower().endswith(OCEL):
            with new_file(target) as begin:
                write_ocel(recording, element_info(models), begin())
            return
        with logging_to(target, models) as log:
            epoch = parse_datetime(recording.metadata.get("epoch", "1970-01-01T00:00:00Z"))
            if epoch != EPOCH:
                log(Event(0, "", 0, 0, "", "epoch", date_text(epoch)))
            length, told = max(1, recording.end - recording.start), 0.0
            for event in recording.events():
                log(event)
                done = (event.time - recording.start) / length
                if done >= told + 0.01:
                    told = done
                    on_progress(done)


def is_recording(path: str | Path) -> bool:
    """Whether a file is a recording, by its name."""
    return Path(path).suffix.lower() == RECORDING
