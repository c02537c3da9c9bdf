"""Write the events of a run to a file, for people, tables, process mining and replay, and read them back.

The suffix of the file selects the format:

.jsonl  one JSON object per event and line
.csv    the same as a table
.xes    IEEE 1849, one trace per process instance (`fame.mining.xes`)

Times are simulated times in seconds, exact to the nanosecond. Nothing depends on the wall clock, so equal runs give
equal bytes. Events are written as they occur. The file is complete when the ``with`` block ends, also after an error.

::

    writing        the files; .mcap files are recordings (docs/recordings.md)
    lines          JSON Lines and CSV
    elements       names and kinds of elements
    reading        the outcomes of the executions of elements
    channels       topics and schemas of a recording
    recorder       collects what the recording of a run in one process has
    recording_file writes it: the file, its channels
    recording      reads recordings (mcap_index finds their chunks)
    team_state     the state of a team at one time, and the keys of a recording
    live_team      follows a team on the network
    team_recorder  records it
    wait_reasons   why a token waits
    merging        several recordings as one
    judge          judges properties in it, in event_logs and in bags; live_judge: while it is made
    property_watch the service that watches a property of the team
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.log.lines import COLUMNS as COLUMNS
    from fame.log.live_team import LiveTeam as LiveTeam
    from fame.log.reading import outcomes as outcomes, visits as visits
    from fame.log.recorder import About as About
    from fame.log.recording import Recording as Recording
    from fame.log.team_state import TeamState as TeamState
    from fame.log.writing import logging_to as logging_to
    from fame.robot.robot_state import RobotState as RobotState
else:
    __getattr__, __dir__, __all__ = attach(__name__)
