"""FAME in many processes: what each of them does, and how a whole scenario is started, watched and ended.

process   what a process does: scheduler, middleware, and a part built on both, until it is told to end
sending   deploying to whoever is there, and staying for those who are not
world     a simulated world, which makes the time of all
team      a scenario in many processes
children  the processes of a team: started, heard and ended together
"""

from __future__ import annotations

from fame.remote.process import BACKENDS, connect, scheduler_for, serve
from fame.remote.sending import Sending
from fame.remote.team import Sight, Team, TeamResult
from fame.remote.world import WorldPart

__all__ = ["BACKENDS", "Sending", "Sight", "Team", "TeamResult", "WorldPart", "connect", "scheduler_for", "serve"]
