"""What a .bpmn file says: read it, write it, draw it. Knows nothing of how a model is run.

`read`, `read_bytes`, `read_text` give the neutral model of `fame.bpmn.model`; `write` and `extract_process` give XML
back. They are imported when first used, so that whoever needs the dataclasses alone does not load an XML parser.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import from_homes

if TYPE_CHECKING:
    from fame.bpmn.reader import read, read_bytes, read_text, write
    from fame.bpmn.split import extract_process
    from fame.bpmn.topics import topic_table

__all__ = ["extract_process", "read", "read_bytes", "read_text", "topic_table", "write"]

_HOMES = {
    "read": "reader",
    "read_bytes": "reader",
    "read_text": "reader",
    "topic_table": "topics",
    "extract_process": "split",
    "write": "reader",
}

__getattr__ = from_homes(__name__, _HOMES)
