"""Topics and services between processes and machines: Eclipse Zenoh, on the wire of rmw_zenoh.

ROS 2 nodes on rmw_zenoh see the nodes of this backend as ROS 2 nodes, and the other way round. Importing
the package raises UnavailableError where Zenoh is not installed.

::

    middleware   the backend: nodes, the graph
    endpoints    publishers, subscriptions, services and clients
    tokens       key expressions, liveliness tokens and attachments, as rmw_zenoh writes them
    session      which peers and routers to connect to: processes of a machine by themselves, others through a router
"""

from fame.imports import require

require("xxhash", "zenoh")

from fame.middleware.zenoh.middleware import ZenohMiddleware  # noqa: E402
from fame.middleware.zenoh.session import locators, open_router  # noqa: E402

__all__ = ["ZenohMiddleware", "locators", "open_router"]
