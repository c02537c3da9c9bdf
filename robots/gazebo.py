"""Topics that missions use and robots in Gazebo usually lack: `range`, made from a laser scan, and a planner.

Most real robots lack them too. Both need only topics: `scan` (sensor_msgs/msg/LaserScan), `odom`, and `map`
(nav_msgs/msg/OccupancyGrid, latched) as published by Nav2's map server.
"""

from __future__ import annotations

import math

from fame.middleware import messages
from fame.middleware.interface import SENSOR_DATA, AnyMessage, Node
from robots.planner import DirectPlanner, Planner, PlannerParameters
from sim2d.robot import MEASUREMENT

RANGE, SCAN = "sensor_msgs/msg/Range", "sensor_msgs/msg/LaserScan"


class ScannedRange:
    """Publishes the nearest point of each scan as `range`: +inf for none, -inf for too near (REP 117)."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.publisher("range", RANGE, MEASUREMENT)
        node.subscription("scan", SCAN, self._on_scan, SENSOR_DATA)

    def _on_scan(self, scan: AnyMessage) -> None:
        seen = [far for far in scan.ranges if scan.range_min <= far <= scan.range_max or far == -math.inf]
        fields = {
            "header": scan.header,
            "field_of_view": abs(scan.angle_max - scan.angle_min),
            "min_range": scan.range_min,
            "max_range": scan.range_max,
            "range": min(seen, default=math.inf),
        }
        self._publisher.publish(messages.create(RANGE, fields))


class Supplement:
    """Planner and range of one robot. `radius` (m) is that of a circle around the robot; 0 for one that flies."""

    def __init__(self, node: Node, radius: float) -> None:
        self.node = node
        if radius > 0:
            self.planner: Planner | DirectPlanner = Planner(node, PlannerParameters(), radius)
            self.range = ScannedRange(node)
        else:
            self.planner = DirectPlanner(node)

    def close(self) -> None:
        self.node.close()
