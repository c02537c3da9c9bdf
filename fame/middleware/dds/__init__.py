"""Topics and services between processes and machines: Eclipse Cyclone DDS on the wire of ROS 2.

ROS 2 nodes (Jazzy, on any DDS) see the nodes of this backend as ROS 2 nodes, and the other way round. Importing
the package raises UnavailableError where Cyclone is not installed.

::

    middleware   the backend: nodes, the graph
    endpoints    publishers, subscriptions, services and clients
    participant  the participant: discovery, warnings, waiting for data
    discovery    endpoints of the domain, and the nodes that they belong to
    waitset      waiting for data
    wire         writers and readers: names, types and quality of service as ROS 2 maps them to DDS
    cyclone      what of cyclonedds is no interface of it
    domain       domain and network interface; sockets bound to loopback
"""

from fame.errors import UnavailableError

try:
    import cyclonedds  # noqa: F401
except ImportError:
    text = "DDS needs Eclipse Cyclone DDS: pip install 'fame-robots[dds]' (or use ROS 2's: --middleware ros)"
    raise UnavailableError(text) from None

from fame.middleware.data_scheduler import DataScheduler as DdsScheduler
from fame.middleware.dds.middleware import DdsMiddleware

__all__ = ["DdsMiddleware", "DdsScheduler"]
