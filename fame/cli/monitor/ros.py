"""Commands that inspect nodes of ROS 2: ``fame param`` and ``fame topic``."""

from __future__ import annotations

import sys
from argparse import Namespace
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fame.cli.arguments import Commands, add_json, add_types, command, natural, positive
from fame.cli.network import add_network, connected, wait_until
from fame.cli.output import print_json, table
from fame.errors import ConfigError, MissionError

if TYPE_CHECKING:
    from fame.clock import Scheduler, WallScheduler
    from fame.middleware.interface import Middleware, QoS


_PARAM_EXAMPLES = ("fame param list /low_pass", "fame param get /low_pass cutoff", "fame param set /low_pass cutoff 5")


def add_param(commands: Commands) -> None:
    """Declare the command and its three subcommands."""
    parser = command(
        commands, "param", run_param, examples=_PARAM_EXAMPLES,
        help="list, show and change parameters of running nodes, as ros2 param does",
    )  # fmt: skip
    parts = parser.add_subparsers(metavar="list|get|set", required=True)
    for name, show, help in (
        ("list", _list_parameters, "list the parameters of a node"),
        ("get", _get_parameter, "print one"),
        ("set", _set_parameter, "change one"),
    ):
        part = parts.add_parser(name, help=help)
        part.add_argument("node", metavar="NODE", help="full name of the node, such as /low_pass")
        if name != "list":
            part.add_argument("name", metavar="NAME")
        if name == "set":
            part.add_argument("value", metavar="VALUE", help="a number, text, true, false, or a list [1, 2]")
        add_network(part)
        add_json(part)
        part.set_defaults(part=show)


def run_param(arguments: Namespace) -> int:
    """Ask the node, and print its answer."""
    from fame.monitor.pipeline.parameters import ParameterClient

    with connected(arguments) as (scheduler, middleware):
        node = middleware.node("_fame_param")
        name = arguments.node if arguments.node.startswith("/") else f"/{arguments.node}"
        client = ParameterClient(node, scheduler, name)
        code: int = arguments.part(client, arguments)
        return code


def _list_parameters(client: Any, arguments: Namespace) -> int:
    names = client.names()
    values, told = client.get(names), client.describe(names)
    if arguments.json:
        print_json({"node": client.other, "parameters": dict(zip(names, values, strict=True))})
        return 0
    rows = [(name, _shown(value), each.description) for name, value, each in zip(names, values, told, strict=True)]
    print(table(("parameter", "value", "description"), rows) if rows else f"{client.other} has no parameters")
    return 0


def _get_parameter(client: Any, arguments: Namespace) -> int:
    (value,) = client.get([arguments.name]) or [None]
    if value is None:
        known = ", ".join(client.names()) or "none"
        raise ConfigError(f"there is no such parameter; there are {known}", file=client.other, element=arguments.name)
    print_json({"name": arguments.name, "value": value}) if arguments.json else print(_shown(value))
    return 0


def _set_parameter(client: Any, arguments: Namespace) -> int:
    from fame.config.loader import parse_document

    client.set(arguments.name, parse_document(arguments.value, arguments.name).data)
    return _get_parameter(client, arguments)


def _shown(value: Any) -> str:
    from fame.monitor.pipeline.topic_tools import float_text

    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return float_text(value) if isinstance(value, float) else str(value)


_TOPIC_EXAMPLES = (
    "fame topic list",
    "fame topic echo /joint_states --field effort.elbow_joint",
    "fame topic hz /joint_states",
    "fame topic pub /cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.2}}' --rate 10",
    "fame topic plot /encoder_loss:data /joint_states:effort --duration 20 -o loss.png",
)


def add_topic(commands: Commands) -> None:
    """Declare the command and its five subcommands."""
    parser = command(
        commands,
        "topic",
        run_topic,
        examples=_TOPIC_EXAMPLES,
        help="inspect topics, and publish on them",
    )
    parts = parser.add_subparsers(metavar="list|echo|hz|pub|plot", required=True)
    listing = parts.add_parser("list", help="list topics with types, publishers and subscribers")
    echo = parts.add_parser("echo", help="print the messages on a topic")
    hz = parts.add_parser("hz", help="print the rate of messages on a topic")
    pub = parts.add_parser("pub", help="publish a message: once, as soon as somebody subscribes, or at a rate")
    plot = parts.add_parser("plot", help="draw numbers of messages over time")
    for part in (echo, hz, pub):
        part.add_argument("topic", metavar="TOPIC")
        part.add_argument("--count", type=natural, default=0, metavar="N", help="end after N messages")
    pub.add_argument("message_type", metavar="TYPE", help="such as geometry_msgs/msg/Twist")
    pub.add_argument(
        "values",
        nargs="?",
        metavar="VALUES",
        help="its fields as YAML or JSON, such as '{linear: {x: 0.2}}', or a number",
    )
    pub.add_argument("--rate", type=positive, metavar="HZ", help="publish until interrupted, --count or --duration")
    echo.add_argument("--field", metavar="PATH", help="print only this field, such as effort.3 or pose.position.x")
    plot.add_argument("series", nargs="+", metavar="TOPIC:PATH", help="such as /joint_states:effort.elbow_joint")
    plot.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.png")
    plot.add_argument(
        "--threshold", type=float, action="append", default=[], metavar="X", help="draw a horizontal line at this value"
    )
    for part, seconds in ((listing, 1.0), (echo, None), (hz, None), (pub, None), (plot, 10.0)):
        standard = f"(default: {seconds:g})" if seconds else "(default: until interrupted)"
        part.add_argument(
            "--duration",
            type=positive,
            default=seconds,
            metavar="S",
            help="seconds to publish, or without --rate to wait for a subscriber (default: 5)"
            if part is pub
            else f"seconds to listen {standard}",
        )
        add_types(part)
        add_network(part)
    add_json(listing)
    for part, show in ((listing, _list_topics), (echo, _echo), (hz, _hz), (pub, _publish), (plot, _plot)):
        part.set_defaults(part=show)


def run_topic(arguments: Namespace) -> int:
    """Subscribe, and print the result; or publish."""
    with connected(arguments) as (scheduler, middleware):
        code: int = arguments.part(arguments, scheduler, middleware)
        return code


def _list_topics(arguments: Namespace, scheduler: Scheduler, middleware: Middleware) -> int:
    _run(arguments, scheduler)
    topics = list(middleware.graph())
    if arguments.json:
        told = [
            {"name": info.name, "types": info.types, "publishers": info.publishers, "subscribers": info.subscribers}
            for info in topics
        ]
        print_json({"topics": told})
        return 0
    rows = [(info.name, ", ".join(info.types), len(info.publishers), len(info.subscribers)) for info in topics]
    print(table(("topic", "type", "publishers", "subscribers"), rows))
    return 0


def _echo(arguments: Namespace, scheduler: Scheduler, middleware: Middleware) -> int:
    from fame.middleware import messages
    from fame.middleware.qos import requested_of
    from fame.monitor.pipeline.fields import UnusableMessage, reader
    from fame.monitor.pipeline.topic_tools import format_message, parse_path

    type = _type(arguments, scheduler, middleware)
    read = reader(type, parse_path(arguments.field)) if arguments.field else None
    left = arguments.count or -1

    def on_message(message: Any) -> None:
        nonlocal left
        if left == 0:
            return
        try:
            value = read(message)[0] if read is not None else format_message(messages.to_mapping(message)) + "---"
        except UnusableMessage as reason:
            print(f"fame: {reason}", file=sys.stderr)
            return
        print(
            value if read is None else format_message(value.tolist() if hasattr(value, "tolist") else value), flush=True
        )
        left -= 1
        if left == 0:
            scheduler.stop()

    offered = next((info.offered for info in middleware.graph() if info.name == arguments.topic), ())
    _listen(arguments, scheduler, middleware, type, on_message, requested_of(offered))  # latched ones, too
    if left > 0:
        raise MissionError(f"{arguments.topic}: received {arguments.count - left} of {arguments.count} messages")
    return 0


def _hz(arguments: Namespace, scheduler: Scheduler, middleware: Middleware) -> int:
    from fame.clock import SECOND
    from fame.middleware.interface import SENSOR_DATA
    from fame.monitor.pipeline.topic_tools import MessageTimes

    type = _type(arguments, scheduler, middleware)
    times = MessageTimes()

    def on_message(message: Any) -> None:
        times.times.append(scheduler.now / SECOND)
        if len(times.times) == arguments.count:
            scheduler.stop()

    def print_rate() -> None:
        print(f"{arguments.topic}: {times.text(scheduler.now / SECOND)}", flush=True)
        scheduler.after(SECOND, print_rate)

    scheduler.after(SECOND, print_rate)
    _listen(arguments, scheduler, middleware, type, on_message, SENSOR_DATA)
    print(f"{arguments.topic}: {times.text(scheduler.now / SECOND, inf)}", flush=True)
    return 0 if len(times.times) >= max(2, arguments.count) else 1


def _publish(arguments: Namespace, scheduler: WallScheduler, middleware: Middleware) -> int:
    """Publish a message. Raises MissionError if nobody subscribes to what is published once."""
    from fame.clock import SECOND
    from fame.middleware import messages
    from fame.middleware.interface import resolve
    from fame.scripting.substitution import flow

    try:
        message = messages.create(arguments.message_type, flow(arguments.values or ""))
    except ValueError as error:
        raise ConfigError(f"expected YAML as VALUES, got {arguments.values!r}: {error}") from None
    topic = resolve(arguments.topic, "")
    publisher = middleware.node("_fame_topic").publisher(topic, messages.type_name(message))
    if not arguments.rate and not wait_until(scheduler, publisher.subscriber_count, arguments.duration or 5.0):
        raise MissionError(f"nobody subscribes to {topic} with the type {publisher.type}")
    sent = 0

    def publish() -> None:
        nonlocal sent
        publisher.publish(message)
        sent += 1
        if sent < (arguments.count or (inf if arguments.rate else 1)):
            scheduler.after(round(SECOND / (arguments.rate or _OFTEN)), publish)
        else:
            scheduler.after(SECOND // 5, scheduler.stop)  # until the last one has arrived

    scheduler.after(0, publish)
    if not arguments.rate:
        arguments.duration = None  # which was that of the wait
    with suppress(KeyboardInterrupt):
        _run(arguments, scheduler)
    print(f"{topic}: {'1 message' if sent == 1 else f'{sent} messages'}")
    return 0


_OFTEN = 10.0
"""The rate (Hz) of several messages, if none is given."""


def _plot(arguments: Namespace, scheduler: Scheduler, middleware: Middleware) -> int:
    from fame.imports import require
    from fame.monitor.pipeline.topic_tools import Series, parse_path, wait_for_types
    from fame.monitor.plots import plot_series

    if arguments.output.suffix.lower() != ".png":
        raise ConfigError(
            f"expected a file with the ending .png, got {arguments.output.suffix!r}", file=str(arguments.output)
        )
    named = [text.partition(":") for text in arguments.series]
    for topic, _, path in named:
        if not topic.startswith("/") or not path:
            raise ConfigError(f"expected /topic:field, such as /joint_states:effort.0, got {topic}")
    require("matplotlib")
    types = wait_for_types(middleware, scheduler, [topic for topic, _, _ in named])
    node = middleware.node("_fame_topic")
    series = [Series(node, scheduler, topic, types[topic], parse_path(path)) for topic, _, path in named]
    _run(arguments, scheduler)
    for each in series:
        if each.unusable:
            print(f"fame: {each.label}: {len(each.unusable)} not usable: {each.unusable[-1]}", file=sys.stderr)
    if not any(each.stamps or each.unusable for each in series):
        raise MissionError("received no message on these topics")
    if not any(each.stamps for each in series):
        return 1
    plot_series(series, arguments.output, thresholds=arguments.threshold)
    print(f"{arguments.output}: {', '.join(f'{len(each.stamps)} samples of {each.label}' for each in series)}")
    return 0


def _type(arguments: Namespace, scheduler: Scheduler, middleware: Middleware) -> str:
    from fame.monitor.pipeline.topic_tools import wait_for_types

    if not arguments.topic.startswith("/"):
        arguments.topic = f"/{arguments.topic}"
    return wait_for_types(middleware, scheduler, [arguments.topic])[arguments.topic]


def _listen(
    arguments: Namespace, scheduler: Scheduler, middleware: Middleware, type: str, on_message: Any, profile: QoS
) -> None:
    middleware.node("_fame_topic").subscription(arguments.topic, type, on_message, profile)
    try:
        _run(arguments, scheduler)
    except KeyboardInterrupt:
        print()


def _run(arguments: Namespace, scheduler: Scheduler) -> None:
    """Listen from now on, for as long as was asked for."""
    from fame.clock import SECOND

    if arguments.duration is not None:
        scheduler.after(round(arguments.duration * SECOND), scheduler.stop)
    scheduler.run()
