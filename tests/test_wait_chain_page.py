"""The page follows what a token waits for through the team, as `fame status --why` does."""

# ruff: noqa: E501 (a model as XML)

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from view_page import becomes, opened, says

from fame.cli import main
from fame.view import Replay

if TYPE_CHECKING:
    from playwright.sync_api import Browser

RING = {"Carrier": ("award", "open"), "Dispatcher": ("bid", "award"), "Door": ("open", "bid")}
"""Robot: the signal that it waits for, and the one that it throws then."""


def collaboration() -> str:
    pools = "".join(f'<participant id="P_{robot}" name="{robot}" processRef="p_{robot}"/>' for robot in RING)
    processes = "".join(
        f'<process id="p_{robot}" isExecutable="true"><startEvent id="s_{robot}"/>'
        f'<subProcess id="h_{robot}" triggeredByEvent="true"><startEvent id="l_{robot}" isInterrupting="false"><timerEventDefinition><timeDuration>PT9S</timeDuration></timerEventDefinition></startEvent></subProcess>'
        f'<intermediateCatchEvent id="c_{robot}" name="{awaited} comes"><signalEventDefinition signalRef="{awaited}"/></intermediateCatchEvent>'
        f'<intermediateThrowEvent id="t_{robot}"><signalEventDefinition signalRef="{thrown}"/></intermediateThrowEvent>'
        f'<sequenceFlow id="f_{robot}" sourceRef="s_{robot}" targetRef="c_{robot}"/>'
        f'<sequenceFlow id="g_{robot}" sourceRef="c_{robot}" targetRef="t_{robot}"/></process>'
        for robot, (awaited, thrown) in RING.items()
    )
    signals = "".join(f'<signal id="{name}" name="{name}"/>' for name, _ in RING.values())
    return f'<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t">{signals}<collaboration id="c">{pools}</collaboration>{processes}</definitions>'


ASK = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:c="http://camunda.org/schema/1.0/bpmn" targetNamespace="t">
  <process id="Dispatcher" name="Dispatcher" isExecutable="true"><startEvent id="s"/><serviceTask id="Ask" name="Ask the door"><extensionElements>
    <c:properties><c:property name="service" value="/Door_1/open"/><c:property name="type" value="std_srvs/srv/Trigger"/></c:properties>
  </extensionElements></serviceTask><sequenceFlow id="f" sourceRef="s" targetRef="Ask"/></process></definitions>"""


@pytest.mark.parametrize("timer", [True, False])
def test_the_inspector_follows_a_wait_from_robot_to_robot(chromium: Browser, tmp_path: Path, timer: bool) -> None:
    model, log = tmp_path / "ring.bpmn", tmp_path / "ring.mcap"
    model.write_text(collaboration() if timer else re.sub("<subProcess.*?</subProcess>", "", collaboration()))
    assert main(["run", str(model), "--log", str(log)]) == 1
    with Replay(log) as replay, opened(chromium, replay) as page:
        page.evaluate("fame.player.seek(fame.store.end - 1e9); fame.select({robot: 0})")
        exits = "what can end that: Carrier, l_Carrier, a timer event; Dispatcher, l_Dispatcher, a timer event"
        says(
            page,
            ".chain",
            "Dispatcher waits at bid comes",
            "Door waits at open comes",
            "Carrier, Dispatcher and Door wait for each other",
            exits if timer else "nothing that is drawn and no other publisher can end that",
        )
        page.locator(".chain button.who").first.click()
        becomes(page, "fame.mission.robots[fame.selected.robot].name", "Dispatcher")


def test_a_service_that_does_not_answer_is_the_end_of_a_chain(chromium: Browser, tmp_path: Path) -> None:
    model, log = tmp_path / "ask.bpmn", tmp_path / "ask.mcap"
    model.write_text(ASK)
    assert main(["run", str(model), "--log", str(log)]) == 1
    with Replay(log) as replay, opened(chromium, replay) as page:
        page.evaluate("fame.player.seek(3e9); fame.select({robot: 0})")
        page.get_by_text("the service /Door_1/open to answer").wait_for()
        page.get_by_text("it has had no server for 3 s").wait_for()
