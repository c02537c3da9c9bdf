"""Static checks of a model: errors, likely mistakes, and notes.

::

    checker          run all checks: the table `CHECKS`; which files are one mission
    scope            what checks work on (the processes of a file and all that they call) and their findings
    gate             refuse to run or deploy a model with errors; all errors of the compiler

    control_flow     unreachable elements, gateways without a way out, joins, endless loops and recursion
    events           times that are not ISO 8601, errors that are caught where nothing throws them
    elements         pools, properties, data objects
    scripts          requests without await, unknown methods, JavaScript without next()
    topics           types, payloads, publishers and subscribers
    service_topics   topics of pipelines and monitors, from their configurations
    signals          robots that wait for each other, signals that get lost
    variables        variables that are read and never set
    value_kinds      variables that are set to different kinds of values
    guidelines       elements without effect; the guidelines of the FaMe paper, on request

    graph, endpoints, expressions    what checks build on

    explore          every reachable state of a collaboration (`fame check --explore`)
    contract         topics, services and actions of a mission, compared with the running nodes
    explain          how a file of another tool was read
    library          the behaviours of a library path
    element_templates  templates for Camunda Modeler

A finding is an ``error`` if the model cannot run, a ``warning`` if it probably does not do what was intended, and a
``note`` otherwise. Called processes are checked too; for other files, only errors and warnings are reported.
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.check.checker import check as check, parts_of_one_mission as parts_of_one_mission
    from fame.check.explain import ReadingDetail as ReadingDetail, readings as readings
    from fame.check.scope import Finding as Finding, Level as Level, summary as summary
else:
    __getattr__, __dir__, __all__ = attach(__name__)
