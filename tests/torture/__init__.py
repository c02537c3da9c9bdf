"""A team of robots, its senders and its faults in one process on simulated time: every run is that of its seed.

The code is that which robots run: engines, senders, splitters and their protocols. Simulated are the clocks and
processes (`processes`), the network (`fabric`) and the disks (`disks`). `plan` draws what happens and which faults
strike, `team` carries it out, `invariants` says what must hold. ``python -m tests.torture --help`` runs it.
"""
