"""Topics and services inside a ROS 2 system: rclpy on the configured RMW.

Importing the package raises UnavailableError where no ROS 2 is sourced, and without rosbags, which no package of ROS
brings. Needed are Jazzy or newer and this Python.

::

    middleware   the backend: a context, its nodes, its executor in a thread, the graph, warnings
    endpoints    publishers, subscriptions, services and clients; types, messages and quality of service of rclpy
"""

from importlib.util import find_spec

from fame.errors import UnavailableError

if find_spec("rosbags") is None:  # imported with the first message type, when an engine may have waited for hours
    _TEXT = (
        "FAME needs rosbags to read message types. Debian's Python takes it in an environment that sees ROS: "
        "python3 -m venv --system-site-packages ~/fame-venv && . ~/fame-venv/bin/activate && pip install rosbags"
    )
    raise UnavailableError(_TEXT)

try:
    import rclpy  # noqa: F401
except ImportError:
    _TEXT = (
        "--middleware ros needs ROS 2's rclpy for this Python: source /opt/ros/jazzy/setup.bash, in an environment "
        "made with --system-site-packages (or speak to ROS without it: --middleware dds)"
    )
    raise UnavailableError(_TEXT) from None

from fame.middleware.ros.middleware import RosMiddleware

__all__ = ["RosMiddleware"]
