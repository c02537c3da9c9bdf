"""Topics and services between processes and machines: Eclipse Zenoh, on the wire of rmw_zenoh.

ROS 2 nodes on rmw_zenoh see the nodes of this backend as ROS 2 nodes, and the other way round. Importing
the package raises UnavailableError where Zenoh is not installed.

::

    middleware   the backend: nodes, the graph
    endpoints    publishers, subscriptions, services and clients
    tokens       key expressions, liveliness tokens and attachments, as rmw_zenoh writes them
    session      which peers and routers to connect to: processes of a machine by themselves, others through a router
"""

from fame.errors import UnavailableError

try:
    import xxhash  # noqa: F401
    import zenoh  # noqa: F401
except ImportError:
    text = "Zenoh needs eclipse-zenoh and xxhash: pip install 'fame-robots[zenoh]' (or use DDS: --middleware dds)"
    raise UnavailableError(text) from None

from fame.middleware.zenoh.middleware import ZenohMiddleware
from fame.middleware.zenoh.session import locators, open_router

__all__ = ["ZenohMiddleware", "locators", "open_router"]
