"""Service tasks that ask a ROS service or action: the payload is the request or goal, the response goes where it says.

The result variable takes the response (of an action its result); else the variables of the data objects at its output
association take the fields named like them; else one variable named like the service takes it. Where the task has an
output mapping, that finds the response as ``msg``, and its fields by their names. Property ``feedback`` names the
variable that takes what an action tells meanwhile.

What cannot be asked is BpmnError ``service``; a goal without success is ``rejected``, ``aborted`` or ``canceled``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from fame.bpmn.model import DataObject, Process, SubProcess, Task, Topic
from fame.engine.data import match, variable_name
from fame.engine.host import BpmnError, Compiled
from fame.engine.variables import UNDEFINED
from fame.errors import MessageError, ModelError
from fame.middleware.messages import is_action
from fame.scripting import Inbox
from fame.scripting.requests import Act, Call, Request


def asking_task(processes: Iterable[Process], element: str) -> tuple[Process, Task] | None:
    """The service task of that id that names a ROS service, and its process."""
    for process in processes:
        for node in process.body.walk():
            if isinstance(node, Task) and node.id == element and node.kind == "service" and node.topic is not None:
                return process, node
    return None


def ask(
    process: Process, task: Task, *, file: str, inbox: Inbox, compile: Callable[..., Compiled]
) -> Callable[[dict[str, Any]], Any]:
    """A function of the variables that gives a coroutine: it asks the service, and hands over the response.

    The client is made now, so that discovery is over in time. Raises ModelError if the task's type is none, or unknown.
    """
    topic = task.topic
    assert topic is not None
    _open(task, topic, file, inbox)
    request = compile(topic.payload, element=task.id, file=file) if topic.payload is not None else None
    objects = _objects(process, task)

    async def wait(variables: dict[str, Any], fields: Any) -> None:
        try:
            response = await _request(task, topic, fields, variables)
        except MessageError as error:
            raise BpmnError("service", str(error)) from error
        variables.update(_taken(task, topic, objects, response))

    def begin(variables: dict[str, Any]) -> Any:
        fields = request(variables) if request is not None else None
        return wait(variables, None if fields is UNDEFINED else fields)

    return begin


def _open(task: Task, topic: Topic, file: str, inbox: Inbox) -> None:
    if topic.type is None:
        text = f"asks the service {topic.name!r} of no type: give it property type, pkg/srv/Name"
        raise ModelError(text, file=file, element=task.id)
    try:
        (inbox.action if is_action(topic.type) else inbox.client)(topic.name, topic.type)
    except MessageError as error:
        raise ModelError(str(error), file=file, element=task.id) from error


def _request(task: Task, topic: Topic, fields: Any, variables: dict[str, Any]) -> Request:
    """What is awaited."""
    type = topic.type or ""
    if not is_action(type):
        return Call(topic.name, type, fields)
    told = task.properties.get("feedback", "").strip()
    return Act(topic.name, type, fields, partial(variables.__setitem__, told) if told else None)


def _objects(process: Process, task: Task) -> list[DataObject]:
    bodies = [process.body, *(node.body for node in process.body.walk() if isinstance(node, SubProcess))]
    return [item for body in bodies for item in body.data_objects if item.id in task.data_outputs]


def _taken(task: Task, topic: Topic, objects: list[DataObject], response: Any) -> Mapping[str, Any]:
    """The variables that a response sets."""
    kept = {task.result_variable: response} if task.result_variable else {}
    if task.io is not None and task.io.outputs:
        fields = {name: getattr(response, name) for name in response.__dataclass_fields__}
        return {"msg": response, **fields, **kept}
    if kept:
        return kept
    name = variable_name(topic.name)
    found = match([name for item in objects for name in item.names], name, response)
    return {name: _field(response, path) for name, path in found.items()} or {name: response}


def _field(response: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        response = getattr(response, name)
    return response
