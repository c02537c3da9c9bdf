"""Topics and services: the interface of a middleware, the messages on it, and its backends.

::

    interface         protocols of all backends: nodes, publishers, subscriptions, services, clients; quality of service
  insistent         requests that are sent again until a server responds
    qos               policies as models write them; which endpoints match
    errors            errors and warnings of all backends
    actions           goals of actions, on services and topics
    simulated_time    following the clock of a world
    parameters        parameter services of nodes
    network           a model of the network for the local backend: delay, loss, partitions

    local             the backend within one process: deterministic, on the engine's clock
    dds               the backend between processes and machines: Cyclone DDS, on the wire of ROS 2
    zenoh             the backend between processes and machines: Eclipse Zenoh, on the wire of rmw_zenoh
    ros               the backend inside a ROS 2 system: rclpy
    data_scheduler    a wall-clock scheduler that waits for data itself
    wire_base         base classes of the backends between processes; wire_endpoints: of their endpoints
    self_echo_filter  drops messages that come back to the node that sent them

    messages          the class of each message type; messages from mappings and values, and plain data from messages
    codec             messages as CDR, and type hashes
    typesystem        the table of message types
    definitions       the definition of a type, and reading `.msg`, `.srv` and `.action` texts
    primitives        the values of primitive fields

To add a backend, derive a middleware, a node, a publisher, a subscription, a service and a client from `wire_base`.
"""

from fame.imports import attach

__getattr__, __dir__, __all__ = attach(__name__)
