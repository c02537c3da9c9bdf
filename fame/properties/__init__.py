"""Properties of a team: sentences over its events and values, judged by small deterministic monitors.

::

    sentence    what a property says, as data
    grammar     parse its text (docs/property_sentences.md has the grammar and the meaning of each pattern)
    vocabulary  the robots, elements, topics and variables of a collaboration, which sentences name
    monitor     compile a property: a `Monitor`, whose state is plain data; parts: its state machines
    conditions  values and comparisons
    judge       many monitors, fed with the events and values of a run; judgement: what it says
    files       properties in YAML files; diagram: deadlines in models

Every host (a run, a replay or an exploration) uses it like this::

    property = parse("Drone completes within 300 s", Location("field.yaml", 12), "finish")
    monitor = compile(property, vocabulary_of(definitions, library, cast))
    state = monitor.initial
    state = monitor.step(state, time, ("Drone", "Process_Drone", "end", "completed"))
    monitor.verdict(state), monitor.deadline(state)

or gives everything to a `Judge`, which finds the monitors that an event concerns and says what broke them.
"""

from fame.imports import attach

__getattr__, __dir__, __all__ = attach(__name__)
