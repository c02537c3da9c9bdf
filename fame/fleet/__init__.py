"""Robots in the field, for those who look after them: health, recordings that engines keep, and fetching these.

::

    diagnostics  reports on /diagnostics of ROS; metrics: for Prometheus; markers: for RViz
    engine_log   the recordings that an engine keeps itself; log_server: offers them to others
"""
