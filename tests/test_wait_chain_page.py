"""The page follows what a token waits for through the team, as `fame status --why` does."""

# ruff: noqa: E501 (a model as XML)

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from view_page import opened, until

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


def test_the_inspector_follows_a_wait_from_robot_to_robot(chromium: Browser, tmp_path: Path) -> None:
    model, log = tmp_path / "ring.bpmn", tmp_path / "ring.mcap"
    model.write_text(collaboration())
    assert main(["run", str(model), "--log", str(log)]) == 1
    with Replay(log) as replay, opened(chromium, replay) as page:
        page.evaluate("fame.player.seek(fame.store.end - 1e9); fame.select({robot: 0})")
        until(page, "!!document.querySelector('.chain')")
        told = page.locator(".chain").first.inner_text().replace("\n", " ")
        assert "Dispatcher waits at bid comes" in told
        assert "Door waits at open comes" in told
        assert "Carrier and Dispatcher and Door wait for each other" in told
        page.locator(".chain button.who").first.click()
        assert page.evaluate("fame.mission.robots[fame.selected.robot].name") == "Dispatcher"
