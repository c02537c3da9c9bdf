"""Writes a model back: exactly the file that was read, with all that FAME does not know."""

from __future__ import annotations

from pathlib import Path

from fame.bpmn.model import Definitions
from fame.bpmn.reader import read_bytes
from fame.errors import ModelError, expect


def write(definitions: Definitions, path: str | Path | None = None) -> bytes:
    """The XML of a model, byte for byte as it was read; written to `path` too if that is given.

    Raises ModelError if `path` cannot be written, or if the model was changed after reading: a file holds more than the
    dataclasses (extensions of others, comments), so a change is made in the file. Raises ConfigError for what is none.
    """
    expect(isinstance(definitions, Definitions), "definitions", definitions, "a model, as fame.read gives it,")
    if not definitions.source or read_bytes(definitions.source, file=definitions.file) != definitions:
        raise ModelError(
            "the model is not the one that was read: change the file, not the model", file=definitions.file
        )
    if path is not None:
        try:
            Path(path).write_bytes(definitions.source)
        except OSError as error:
            raise ModelError(f"cannot be written: {error.strerror}", file=str(path)) from None
    return definitions.source
