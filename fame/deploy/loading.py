"""From a model that was sent to a process that is ready, and who has to be there before it may start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.deploy.beside import Task
from fame.errors import FameError, ModelError
from fame.middleware.interface import Middleware

if TYPE_CHECKING:
    from fame.bpmn.library import Library
    from fame.robot import Mission, RobotNode, Service

KEPT = 10
"""How many instances that have ended an engine remembers."""


def load(
    model: str, robot: str, *, library: Library | None, services: Mapping[str, Service] | None, **options: Any
) -> Task[RobotNode]:
    """A robot's node with the process of a .bpmn text, its endpoints made. `options` are those of `RobotNode`.

    A task of `fame.deploy.beside`: the text is read, checked and compiled beside the scheduler's thread. Raises
    ModelError, MessageError, ConfigError: also for what would fail only when a token gets there, and for whatever else
    goes wrong, since what runs must not end for a model that is to take its place.
    """
    try:
        return (yield from _load(model, robot, library, services, options))
    except FameError:
        raise
    except Exception as error:
        raise ModelError(f"cannot be loaded: {type(error).__name__}: {error}", file=f"{robot}.bpmn") from error


def _load(
    model: str,
    robot: str,
    library: Library | None,
    services: Mapping[str, Service] | None,
    options: Mapping[str, Any],
) -> Task[RobotNode]:
    mission = yield partial(_read, model, robot, library, services)
    from fame.monitor.services import SERVICES
    from fame.robot import RobotNode

    node = RobotNode(robot, mission, keep=KEPT, built_in_services=SERVICES, compiled=False, **options)
    try:
        node.assemble((yield node.compile_process))
        node.load()
    except BaseException:
        node.close()
        raise
    return node


def _read(model: str, robot: str, library: Library | None, services: Mapping[str, Service] | None) -> Mission:
    import fame.monitor.services  # noqa: F401
    from fame.bpmn.library import Library
    from fame.bpmn.reader import read_text
    from fame.check.gate import refuse_literals
    from fame.robot import make_mission
    from fame.simulation import choose_process

    library = library or Library()
    definitions = read_text(model, file=f"{robot}.bpmn")
    pools = [pool for pool in definitions.participants if pool.process]
    process = choose_process(definitions, pools[0].process if len(pools) == 1 else None)
    refuse_literals(definitions, [process], library)
    return make_mission(definitions, process, library=library, services=services)


def missing(promises: Mapping[str, str], robot: str, middleware: Middleware) -> Sequence[str]:
    """Promised ends that are not there, as ``topic (publisher)``. Those of the robot itself do not count."""
    if not promises:
        return ()
    graph = {info.name: info for info in middleware.graph()}
    absent = []
    for topic, end in promises.items():
        info = graph.get(topic)
        ends = () if info is None else info.publishers if end == "publisher" else info.subscribers
        if all(name.startswith(f"/{robot}/") for name in ends):
            absent.append(f"{topic} ({end})")
    return absent
