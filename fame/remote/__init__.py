"""FAME in many processes: what each of them does, and how a whole scenario is started, watched and ended.

process   what a process does: scheduler, middleware, and a part built on both, until it is told to end
sending   deploying to whoever is there, and staying for those who are not
world     a simulated world, which makes the time of all
team      a scenario in many processes
result    how such a run stands, and how it went
children  the processes of a team: started, heard and ended together
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import from_homes
from fame.remote.process import BACKENDS, connect, scheduler_for, serve

if TYPE_CHECKING:
    from fame.remote.result import Sight
    from fame.remote.sending import Sending
    from fame.remote.team import Team
    from fame.remote.world import WorldPart

__all__ = ["BACKENDS", "Sending", "Sight", "Team", "WorldPart", "connect", "scheduler_for", "serve"]

_HOMES = {"Sending": "sending", "Sight": "result", "Team": "team", "WorldPart": "world"}

__getattr__ = from_homes(__name__, _HOMES)
"""What only some processes do is imported when it is first asked for."""
