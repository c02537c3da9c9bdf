"""Processes whose tasks are scripts in JavaScript, for tests."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import fame
from fame.bpmn.model import Definitions
from fame.bpmn.reader import read_text
from fame.middleware import messages

ROOT = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
  xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="test"> <error id="Low" errorCode="low"/>
"""


def task(id: str, text: str) -> str:
    """A script task; the script begins in the line of its tag."""
    return f'<scriptTask id="{id}" scriptFormat="javascript"><script><![CDATA[{text}]]></script></scriptTask>\n'


def flows(*chain: str) -> str:
    """Sequence flows from each to the next."""
    return "".join(f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(chain))


def definitions(content: str, root: str = "") -> Definitions:
    """A file with one process, whose content begins in line 4."""
    return read_text(
        f'{ROOT}{root}<process id="P" isExecutable="true">\n{content}</process></definitions>', file="m.bpmn"
    )


def chain(*texts: str) -> Definitions:
    """A process of script tasks ``t1``, ``t2`` ... one after the other; the first stands in line 4."""
    ids = [f"t{number}" for number in range(1, len(texts) + 1)]
    tasks = "".join(task(id, text) for id, text in zip(ids, texts, strict=True))
    return definitions(f'{tasks}<startEvent id="s"/><endEvent id="e"/>{flows("s", *ids, "e")}')


def simulate(*texts: str, **variables: Any) -> fame.Simulation:
    """Such a process on robot REX, ready to run."""
    return fame.Simulation(chain(*texts), variables=variables, robot="REX")


def run(*texts: str, **variables: Any) -> dict[str, Any]:
    """Run it to its end; gives the variables."""
    (instance,) = simulate(*texts, **variables).run().instances
    assert instance.error is None
    assert instance.status == "completed"
    return instance.variables


def error_of(*texts: str, **variables: Any) -> fame.MissionError:
    """Run it until it fails; gives the error."""
    (instance,) = simulate(*texts, **variables).run().instances
    assert instance.status == "failed"
    assert isinstance(instance.error, fame.MissionError)
    return instance.error


class Peer:
    """Another node in the namespace of the robot, that hears and says."""

    def __init__(self, simulation: fame.Simulation) -> None:
        self.scheduler = simulation.scheduler
        self.node = simulation.middleware.node("peer", "REX")
        self.heard: list[tuple[str, Any]] = []

    def hear(self, topic: str, type: str) -> Peer:
        """Write down what comes on a topic."""
        self.node.subscription(topic, type, lambda message: self.heard.append((topic, message)))
        return self

    def say(self, topic: str, type: str, *values: Any, every: float = 1.0) -> Peer:
        """Publish the values, one each `every` seconds, the first after that time."""
        publisher = self.node.publisher(topic, type)
        for number, value in enumerate(values, 1):
            message = messages.create(type, value)
            self.scheduler.at(round(number * every * 1e9), lambda message=message: publisher.publish(message))
        return self
