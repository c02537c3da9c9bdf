"""Writes the events of a run to a file, for people, tables and process mining; reads back where a run went.

The ending of the file decides its form:

.jsonl  one JSON object per event and line
.csv    the same as a table
.xes    IEEE 1849, one trace per process instance (`fame.log.xes`)

Times are simulated, in seconds, with every digit that counts. Nothing depends on the wall clock, so equal runs give
equal bytes. Events are written as they come, and the file is whole when the block ends, however it ends.

::

    writing   the files
    lines     JSON Lines and CSV
    xes       IEEE 1849
    naming    what elements are called
    reading   where a run went, and what became of it
"""

from __future__ import annotations

from fame.log.lines import COLUMNS
from fame.log.reading import outcomes, visits
from fame.log.writing import logging_to

__all__ = ["COLUMNS", "logging_to", "outcomes", "visits"]
