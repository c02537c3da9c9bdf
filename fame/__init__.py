"""FAME runs the missions of a team of robots straight from BPMN 2.0 collaboration diagrams.

::

    import fame

    definitions = fame.read("mission.bpmn")
    simulation = fame.Simulation(definitions, process="main", variables={"x": 0})
    simulation.run()
    simulation.instances[0].status

Names are imported on first use. docs/python.md lists the packages whose names are public.
"""

from fame.imports import attach

__getattr__, __dir__, __all__ = attach(__name__)
