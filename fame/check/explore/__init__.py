"""Explore the reachable states of a collaboration, by the engine that runs it, before anything moves.

::

    exploration     the searches of a team, within one budget
    request         what to explore
    result          what was searched, and what is known after it
    team            the robots of a collaboration, ready to be explored
    deliveries      the search with one way of delivery
    samples         parts that a search may not have reached
    merging         findings and verdicts of several searches
    places          elements of the models, and what they accept
    abstraction     what is left out of a model: work inside behaviours, variables that decide nothing
    behaviours      called processes that are explored as one step
    team_facts      what all processes of a team have in common
    failures        with which codes scripts, services and behaviours fail, and which nothing catches
    error_codes     which codes are thrown, and caught
    decisive        variables and payloads that decide something
    element_variables  what elements use besides their texts
    slicing         statements of scripts that decide nothing
    mismatches      what texts may raise on values of another kind
    counting        lists of which only the length is read
    aliases         variables that may hold the same list or mapping
    asking          scripts and conditions that ask unknown values
    purity          which scripts are executed
    values          known values by number, and the unknown one
    host            the host of an explored engine
    liveness        variables that nothing reads any more
    remembering     unknown conditions with one outcome while their variable is unchanged
    timers          pending timers, and which may fire next
    stimuli         what may happen to a robot
    views           what can happen in a local state
    growth          states that are not explored: too many instances or tokens
    footprints      what a step reads and writes
    canonical       engines as hashable forms, equal for equal behaviour; contents: their variables
    revival         from a form back to an engine
    states          the states of one robot, by number
    local           the transitions of one robot, computed by the engine and cached
    running_states  states of running robots, to explore from
    transitions     transitions of the team: moves of robots
    network         messages in transit
    broadcast       delivery to all receivers at once
    symmetry        robots that nothing tells apart
    kinds           robots of one pool that do not start alike
    product         what may happen in each state of the team
    reduction       steps that need not be interleaved with those of others
    independence    steps of parallel branches that commute
    stubborn        robots with which no other can interfere
    faults          single faults as transitions
    graph           explored states, and what can be reached from where
    search          all states of the team, breadth first
    sampling        runs that a search has not reached: the schedule of fame run, random ones
    trace           runs, in the terms of the model
    properties      sentences about the team, proved or refuted
    findings        deadlocks, lost signals, errors ... one per cause

`docs/exploration.md` says what is abstracted and what follows from that.
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.check.explore.exploration import explore_from as explore_from, explore_team as explore_team
    from fame.check.explore.findings import Finding as Finding
    from fame.check.explore.request import Request as Request
    from fame.check.explore.result import Exploration as Exploration
else:
    __getattr__, __dir__, __all__ = attach(__name__)
