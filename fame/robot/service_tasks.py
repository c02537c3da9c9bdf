"""Service tasks that call a ROS service or action.

The payload is the request or goal. The response (of an action its result) goes to the result variable of the task; else
the variables of the data objects at its output association take the fields of the same name; else the variable named
like the service takes it. In an output mapping the response is ``msg``, and its fields go by their names. Property
``feedback`` lists variables that take the feedback of an action: one named like a field takes that field, another one
the whole message.

A service or action that cannot be called is BpmnError ``service``; a goal without success is ``rejected``, ``aborted``
or ``canceled``. Property ``errors`` gives these other codes, and codes to the values of the field ``error_code`` of the
result of an aborted goal: ``{rejected: nav2.goal_rejected, 208: nav2.no_valid_path}``.

Property ``wait_cancelled`` is for how long a goal waits until those of the action that were cancelled have ended (s);
then it is BpmnError ``still_running``. Without it the goal is sent at once: a server that preempts ends the others so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from fame.bpmn.model import DataObject, Process, Task, Topic
from fame.config.loader import parse_document
from fame.engine.data import UNDEFINED, Variables, field_names, match, variable_name
from fame.engine.host import BpmnError
from fame.engine.program import Compiled
from fame.errors import ConfigError, MessageError, ModelError
from fame.middleware import messages
from fame.middleware.messages import is_action
from fame.scripting import Inbox
from fame.scripting.requests import STILL_RUNNING, Act, Call, GoalError, ScriptRequest, check_seconds


def ros_service_task(processes: Iterable[Process], element: str) -> tuple[Process, Task] | None:
    """Return the service task of that id that names a ROS service, and its process."""
    for process in processes:
        for node in process.body.walk():
            if isinstance(node, Task) and node.id == element and node.service is not None:
                return process, node
    return None


def call_service(
    process: Process, task: Task, *, file: str, compile: Callable[..., Compiled]
) -> Callable[[dict[str, Any]], Any]:
    """Return the function of such a task: takes the variables, and gives a coroutine that calls the service.

    Touches no endpoint: `make_client` does. Raises ModelError if the task has no known type.
    """
    topic = task.topic
    assert topic is not None
    with _located(task, file):
        (messages.action if is_action(topic.type or "") else messages.service)(_type(task, topic, file))
    codes, wait = error_codes(task, file), _wait(task, file)
    request = compile(topic.payload, element=task.id, file=file) if topic.payload is not None else None
    objects = [item for body in process.body.bodies() for item in body.data_objects if item.id in task.data_outputs]

    async def call(variables: dict[str, Any], fields: Any) -> None:
        try:
            response = await _request(task, topic, fields, variables, wait)
        except MessageError as error:
            raise BpmnError(codes.get("service", "service"), str(error)) from error
        except BpmnError as error:
            if not codes:
                raise
            raise _renamed(error, codes) from error
        results = _outputs(task, topic, objects, response)
        if task.io is not None and task.io.outputs and isinstance(variables, Variables):  # read by its mapping alone
            for name, value in results.items():
                variables.define(name, value)
        else:
            variables.update(results)

    def begin(variables: dict[str, Any]) -> Any:
        fields = request(variables) if request is not None else None
        return call(variables, None if fields is UNDEFINED else fields)

    return begin


def make_client(task: Task, file: str, inbox: Inbox) -> None:
    """Make the client of such a task at load, so that discovery is over in time. Raises ModelError."""
    topic = task.topic
    assert topic is not None
    type = _type(task, topic, file)
    with _located(task, file):
        (inbox.action if is_action(type) else inbox.client)(topic.name, type)


def _type(task: Task, topic: Topic, file: str) -> str:
    if topic.type is None:
        text = f"calls the service {topic.name!r} without a type: expected the property type, pkg/srv/Name"
        raise ModelError(text, file=file, element=task.id)
    return topic.type


@contextmanager
def _located(task: Task, file: str) -> Iterator[None]:
    """Raise a MessageError of the block as a ModelError of the task."""
    try:
        yield
    except MessageError as error:
        raise ModelError(str(error), file=file, element=task.id) from error


def _wait(task: Task, file: str) -> float:
    """The property ``wait_cancelled`` (s). Raises ModelError."""
    text = task.properties.get("wait_cancelled", "0").strip()
    try:
        check_seconds("wait_cancelled", seconds := float(text))
    except ValueError:
        error = f"property wait_cancelled: expected a number of seconds, got {text!r}"
        raise ModelError(error, file=file, element=task.id) from None
    return seconds


def _request(task: Task, topic: Topic, fields: Any, variables: dict[str, Any], wait: float) -> ScriptRequest:
    """The request that the coroutine awaits."""
    type = topic.type or ""
    if not is_action(type):
        return Call(topic.name, type, fields)
    names = [name.strip() for name in task.properties.get("feedback", "").split(",") if name.strip()]
    return Act(topic.name, type, fields, partial(_take_feedback, variables, names) if names else None, wait)


def _take_feedback(variables: dict[str, Any], names: Iterable[str], feedback: Any) -> None:
    for name in names:
        variables[name] = getattr(feedback, name, feedback)


def error_codes(task: Task, file: str = "") -> Mapping[str | int, str]:
    """Return the property ``errors``: outcome or value of ``error_code`` -> code of a BPMN error. Raises ModelError."""
    text = task.properties.get("errors", "").strip()
    if not text:
        return {}
    codes: Any = None
    with suppress(ConfigError):
        codes = parse_document(text).data
    valid = isinstance(codes, dict) and all(isinstance(key, str | int) for key in codes)
    if not valid or not all(isinstance(code, str) and code for code in codes.values()):
        expected = "expected a mapping such as {rejected: nav2.goal_rejected, 208: nav2.no_valid_path}"
        raise ModelError(f"property errors: {expected}, got {text!r}", file=file, element=task.id)
    return codes  # type: ignore[no-any-return]


def failure_codes(task: Task, but: Set[str] = frozenset()) -> set[str]:
    """Return the codes with which such a task may fail, without some outcomes, as property ``errors`` renames them."""
    goal = task.service is not None and is_action(task.service.type or "")
    outcomes = {"service", *(("aborted", "canceled", "rejected") if goal else ())}
    outcomes |= {"lost"} if task.properties.get("retry") in ("never", "ask") else set()
    outcomes |= {STILL_RUNNING} if "wait_cancelled" in task.properties else set()
    renamed = renamed_codes(task)
    numbers = {code for outcome, code in renamed.items() if isinstance(outcome, int) and goal}
    return {renamed.get(outcome, outcome) for outcome in outcomes - but} | numbers


def renamed_codes(task: Task) -> Mapping[str | int, str]:
    """Return the property ``errors`` of a call; of an invalid one, which is refused, nothing."""
    with suppress(ModelError):
        return error_codes(task) if task.service is not None else {}
    return {}


def _renamed(error: BpmnError, codes: Mapping[str | int, str]) -> BpmnError:
    """The error with the code that the task gives it, and what the result of a goal says."""
    result = error.result if isinstance(error, GoalError) else None
    number = getattr(result, "error_code", 0) if error.code == "aborted" else ""  # that of no other outcome
    text = getattr(result, "error_msg", "")
    reason = f"error code {number}{f', {text}' if text else ''}" if number else text
    message = f"{error.message} ({reason})" if reason else error.message
    return BpmnError(codes.get(number) or codes.get(error.code, error.code), message)


def _outputs(task: Task, topic: Topic, objects: list[DataObject], response: Any) -> Mapping[str, Any]:
    """The variables that a response sets."""
    kept = {task.result_variable: response} if task.result_variable else {}
    if task.io is not None and task.io.outputs:
        names = (*response.__dataclass_fields__, *field_names(response))
        fields = {name: getattr(response, name) for name in names}
        return {"msg": response, **fields, **kept}
    if kept:
        return kept
    name = variable_name(topic.name)
    paths = match([name for item in objects for name in item.names], name, response)
    return {name: _field(response, path) for name, path in paths.items()} or {name: response}


def _field(response: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        response = getattr(response, name)
    return response
