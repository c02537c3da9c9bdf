"""FAME in many processes: what each of them does, and how a whole scenario is started, watched and ended.

process  what a process does: scheduler, middleware, and a part built on both, until it is told to end
sending  deploying to whoever is there
team     a scenario in many processes
"""

from __future__ import annotations

from fame.remote.process import BACKENDS, connect, scheduler_for, serve
from fame.remote.sending import deploy
from fame.remote.team import WORLD_STATE, Team, TeamResult

__all__ = ["BACKENDS", "WORLD_STATE", "Team", "TeamResult", "connect", "deploy", "scheduler_for", "serve"]
