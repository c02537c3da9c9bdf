from fame.middleware.dds import DdsMiddleware as DdsMiddleware
from fame.middleware.interface import Middleware as Middleware, Node as Node, QoS as QoS
from fame.middleware.local import LocalMiddleware as LocalMiddleware
from fame.middleware.messages import register_files as register_files
from fame.middleware.network import Link as Link, NetworkConfig as NetworkConfig, Partition as Partition
from fame.middleware.zenoh import ZenohMiddleware as ZenohMiddleware
