"""What a .bpmn file says: read it, write it, draw it. Knows nothing of how a model is run.

`read`, `read_bytes`, `read_text` give the neutral model of `fame.bpmn.model`; `write` and `extract_process` give XML
back. They are imported when first used, so that whoever needs the dataclasses alone does not load an XML parser.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import attach

if TYPE_CHECKING:
    from fame.bpmn.reader import read as read, read_bytes as read_bytes, read_text as read_text, write as write
    from fame.bpmn.split import extract_process as extract_process
    from fame.bpmn.topics import topic_table as topic_table
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "reader": ["read", "read_bytes", "read_text", "write"],
            "split": ["extract_process"],
            "topics": ["topic_table"],
        },
    )
