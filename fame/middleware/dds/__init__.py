"""Topics and services between processes and machines: Eclipse Cyclone DDS on the wire of ROS 2.

Any ROS 2 node (Jazzy, on any DDS) sees the nodes of this backend as nodes of its own kind, and they see it. Importing
the package raises UnavailableError where Cyclone is not installed.

::

    middleware        the backend: one participant, its nodes, the graph, warnings, clean leaving
    nodes             nodes, publishers and subscriptions
    services          services and clients, as rmw_cyclonedds writes them
    discovery         who is there: endpoints, and the nodes that they belong to
    information       what a participant tells of its nodes
    reading           waiting for data
    scheduler         the wall clock that does so itself
    lockstep          messages that wait for their step, and come in the same order every time
    domain            which domain and network interface
    confinement       loopback that is loopback
    entities          writers and readers, and their topics
    policies          quality of service in the words of Cyclone
    described         what Cyclone tells of the few basic types
    wire              types, names and hashes as ROS 2 writes them; messages as bytes
"""

from __future__ import annotations

from fame.errors import UnavailableError

try:
    import cyclonedds  # noqa: F401
except ImportError:
    text = "DDS needs Eclipse Cyclone DDS: pip install 'fame-robots[dds]' (or use ROS 2's: --middleware ros)"
    raise UnavailableError(text) from None

from fame.middleware.dds.middleware import DdsMiddleware
from fame.middleware.dds.scheduler import DdsScheduler

__all__ = ["DdsMiddleware", "DdsScheduler"]
