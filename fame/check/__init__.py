"""What is wrong or doubtful in a model, before anything moves.

::

    whole        all that follows, of a file; and which files are one mission
    subject      the processes of a file and all that they call
    compiling    what the compiler refuses, all of it
    catching     errors that nothing throws where they are caught
    start_end    flows that lead the wrong way at start and end events
    flow         what tokens never reach, gateways without a way out
    coverage     conditions of which one is always true
    joins        joins that wait in vain, merges that let through too often
    loops        loops that neither wait nor end
    recursion    calls without end
    timers       times that are none
    topics       types, payloads, and who is at the other end
    progress     how far tokens can get, given what is thrown
    order        robots that wait for each other, signals that come too early
    delivery     signals thrown just before the only catch, queues beyond the depth
    texts        what each text reads and writes
    variables    what is read and never set
    kinds        variables that two elements use otherwise, payloads whose values do not fit
    guidelines   the guidelines of the FaMe paper, as notes
    script_mistakes  requests without await, misspelt methods
    slips        a decimal comma, an arrow the wrong way round
    quirks       habits of other tools that a model relies on
    refusing     what a run and a deployment refuse
    findings     what all of them give
    explain      no finding: what a foreign file was read as

A finding is an ``error`` if the model cannot run, a ``warning`` if it hardly means what it says, a ``note`` else.
What is called is checked too; of other files errors and warnings are told, their notes are not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fame.lazy import attach

if TYPE_CHECKING:
    from fame.check.checker import check as check, parts_of_one_mission as parts_of_one_mission
    from fame.check.findings import Finding as Finding, Level as Level, summary as summary
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "checker": ["check", "parts_of_one_mission"],
            "findings": ["Finding", "Level", "summary"],
        },
    )
