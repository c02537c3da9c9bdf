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
    relay        one participant for engines that were forked; `relayed` is their backend, `link` what lies between
    cyclone      the internals of cyclonedds that are used
    domain       domain and network interface; sockets bound to loopback
"""

from fame.imports import require

require("cyclonedds")

from fame.middleware.data_scheduler import DataScheduler as DdsScheduler  # noqa: E402
from fame.middleware.dds.middleware import DdsMiddleware  # noqa: E402

__all__ = ["DdsMiddleware", "DdsScheduler"]
