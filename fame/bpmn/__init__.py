"""BPMN 2.0 models: read, write, split, convert and draw .bpmn files. Independent of how a model is run.

`read`, `read_bytes` and `read_text` return the neutral model of `fame.bpmn.model`; `write` and `extract_process` return
XML. They are imported on first use, so that the dataclasses alone do not load an XML parser.

::

    model        the neutral model: frozen dataclasses
    reader       XML -> model, for all dialects
    topics       the topics of a model and their message types
    library      called processes, from library files
    pools        the pools of a collaboration, and their robots
    linked_forms the forms of tasks that are in files beside a model
    split        a collaboration -> one file per pool (with merging)
    conversion   other dialects -> the current form
    draw         a model -> SVG
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.bpmn.reader import read as read, read_bytes as read_bytes, read_text as read_text, write as write
    from fame.bpmn.split import extract_process as extract_process
    from fame.bpmn.topics import topic_table as topic_table
else:
    __getattr__, __dir__, __all__ = attach(__name__)
