"""Writes the events of a run to a file, for people, tables and process mining, and reads its path back.

The suffix of the file selects the format:

.jsonl  one JSON object per event and line
.csv    the same as a table
.xes    IEEE 1849, one trace per process instance (`fame.log.xes`)

Times are simulated times in seconds, exact to the nanosecond. Nothing depends on the wall clock, so equal runs give
equal bytes. Events are written as they occur. The file is complete when the ``with`` block ends, also after an error.

::

    writing   the files
    lines     JSON Lines and CSV
    xes       IEEE 1849
    elements  names and kinds of elements
    reading   visited elements, and the outcomes of their executions
"""

from __future__ import annotations

from fame.log.lines import COLUMNS
from fame.log.reading import outcomes, visits
from fame.log.recorder import About
from fame.log.recording import Recording
from fame.log.team_state import RobotState, TeamState
from fame.log.writing import logging_to

__all__ = ["COLUMNS", "About", "Recording", "RobotState", "TeamState", "logging_to", "outcomes", "visits"]
