"""Topics and services: what a middleware is asked for, the messages on it, and its backends.

::

    interface         what every backend gives: nodes, publishers, subscriptions, services; QoS profiles
    actions           goals that take their time, on services and topics
    simulated_time    following the clock that a world says
    local             the backend within one process: deterministic, on the engine's clock
    local_services    its services
    dds               the backend between processes and machines: Cyclone DDS, on the wire of ROS 2
    ros               the backend inside a ROS 2 system: rclpy
    wired             what these two share: nodes that keep their ends, warnings, waiting for others
    echoes            what comes back to the node that sent it, told from what others say
    refusals          what every backend refuses, in the same words
    messages          making messages from mappings and values, and plain data from messages
    codec             messages on the wire of ROS 2, and type hashes
    basics            the few types that are known without rosbags
    qos               policies as models write them; which ends understand each other
    classes           the class of each message type
    typesystem        which types there are
    definitions       what a type is, and reading `.msg` and `.srv` texts
    primitives        the values of primitive fields
"""
