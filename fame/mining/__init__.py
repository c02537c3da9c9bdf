"""Recordings as what other tools read: event logs for process mining, tables, bags of ROS 2.

::

    conversion     a recording as another log, by its suffix
    xes            IEEE 1849
    ocel           OCEL 2.0
    mission_level  what somebody drew of a mission
"""
