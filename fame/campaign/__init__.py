"""Many runs of a scenario with other seeds, values, faults and networks: probabilities with their intervals.

::

    variation   what varies between the runs
    runs        the runs, on many cores or machines, and the folder of their results
    properties  properties in these results
    report      the result: distributions, failures by cause, influence of parameters
"""
