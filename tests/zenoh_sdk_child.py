"""A node of zenoh-ros2-sdk, an implementation of rmw_zenoh's protocol that is not ours, in a process of its own.

It publishes what it receives on /to_sdk again on /from_sdk, offers /sdk_switch, and calls /fame_switch for each request
to it. Run as ``python zenoh_sdk_child.py PORT DOMAIN``; it says on standard output what it sees.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_service_names_and_types, get_topic_info, get_topic_names_and_types
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

port, domain = int(sys.argv[1]), int(sys.argv[2])
STRING = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data\n"}
SWITCH = {
    "srv_type": "std_srvs/srv/SetBool",
    "request_definition": "bool data",
    "response_definition": "bool success\nstring message",
}
PLACE: dict[str, Any] = {"domain_id": domain, "router_port": port, "namespace": "/SDK"}

echo = ROS2Publisher("/from_sdk", **STRING, node_name="echo", **PLACE)
latched = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)
heard = ROS2Subscriber("/to_sdk", callback=lambda message: echo.publish(data=message.data), **STRING, **PLACE)
time.sleep(0.5)
late = ROS2Subscriber(
    "/map", callback=lambda message: echo.publish(data=f"map {message.data}"), qos=latched, **STRING, **PLACE
)
asker = ROS2ServiceClient(
    "/REX/engine/get_parameter_types",
    "rcl_interfaces/srv/GetParameterTypes",
    request_definition="string[] names",
    response_definition="uint8[] types",
    timeout=5.0,
    **PLACE,
)
client = ROS2ServiceClient("/fame_switch", timeout=5.0, **SWITCH, **PLACE)


def switch(request: Any) -> Any:
    answer = client.call(data=request.data)
    return server.response_msg_class(success=answer.success, message=f"sdk: {answer.message}")


server = ROS2ServiceServer("/sdk_switch", callback=switch, **SWITCH, **PLACE)
print("ready", flush=True)
for line in sys.stdin:
    if line.strip() == "parameters":
        print(list(map(int, asker.call(names=["use_sim_time", "unknown"]).types)), flush=True)
    if line.strip() == "graph":
        info = get_topic_info("/to_sdk", domain_id=domain, verbose=True)
        names = sorted(f"{end.node_namespace}/{end.node_name}" for end in info.publishers)
        types = [f"{name}={','.join(found)}" for name, found in get_topic_names_and_types(domain_id=domain)]
        services = [name for name, _ in get_service_names_and_types(domain_id=domain)]
        print(names, types, sorted(services), [end.qos for end in info.publishers], flush=True)
