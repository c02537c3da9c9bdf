"""Topics and services inside a ROS 2 system: rclpy, and whatever it runs on.

Importing the package raises UnavailableError where no ROS 2 is sourced. Needed are Jazzy or newer and this Python.

::

    middleware        the backend: a context, its executor in a thread, the graph, warnings
    nodes             nodes, publishers and subscriptions
    services          services and clients
    translation       types, messages and quality of service in the words of rclpy, and back
"""

from __future__ import annotations

from fame.errors import UnavailableError

try:
    import rclpy  # noqa: F401
except ImportError:
    text = (
        "--middleware ros needs ROS 2's rclpy for this Python: source /opt/ros/jazzy/setup.bash, in an environment "
        "made with --system-site-packages (or speak to ROS without it: --middleware dds)"
    )
    raise UnavailableError(text) from None

from fame.middleware.ros.middleware import RosMiddleware

__all__ = ["RosMiddleware"]
