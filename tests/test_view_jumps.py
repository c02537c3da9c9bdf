"""Jumps: what the server answers for an instant that it has not read yet, and what the page then shows."""

# ruff: noqa: E501 (expressions of JavaScript)

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from view_page import opened, until

from fame.log.recording_file import RecordingFile
from fame.robot.robot_state import RobotState, ScopeState
from fame.view import Replay, Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROBOTS, SECOND = 12, 1_000_000_000
NAMES = [f"R_{number + 1:02}" for number in range(ROBOTS)]
GROUND = {"bounds": [0, 0, 10, 10], "walls": True, "obstacles": [], "targets": [], "chargers": [], "weeds": []}


def scene(entity: str, key: str, value: object) -> dict[str, Any]:
    """A message of the world, with a value of FAME's own."""
    return {"entities": [{"id": entity, "metadata": [{"key": key, "value": json.dumps(value)}]}]}


def x_at(time: int, begins: int) -> float:
    """Where the first robot is: it drives at 1 m/s, and is put back where its simulation begins again."""
    return (time - (begins if time >= begins else 0)) / SECOND


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve robots for 8 s, with a variable each that changes ten times a second, and a simulation that begins again."""
    path = tmp_path_factory.mktemp("view") / "run.mcap"
    with path.open("wb") as stream:
        file = RecordingFile(stream)
        file.describe({})
        for name in NAMES:
            started = {"instance": 1, "scope": 1, "marks": [["P", "start"]]}
            opens = [{"scope": 1, "instance": 1}]
            file.put("/fame/events", 0, {"robot": name, "opens": opens, "events": [started]})
        file.put("/fame/ground", 0, scene("ground", "ground", GROUND))
        state = RobotState("P", scopes={1: ScopeState(1)}).to_key()
        robots = dict.fromkeys(NAMES, state)
        for step in range(80):
            time = step * SECOND // 10
            if step % 10 == 0:
                file.put("/fame/key", time, {"robots": robots})
            pose = {"type": "car", "x": x_at(time, 5 * SECOND), "y": 1.0, "heading": 0.0}
            file.put("/fame/world", time + 1, scene(NAMES[0], "appearance", pose))
            for number, name in enumerate(NAMES):
                change = {"scope": 1, "set": {"step": step * 100 + number}}
                file.put("/fame/variables", time + 1 + number // 2, {"robot": name, "changes": [change]})
        file.finish()
    return path


@pytest.fixture(scope="module")
def replay(recording: Path) -> Iterator[Replay]:
    with Replay(recording) as found:
        found.wait()
        yield found


@pytest.mark.parametrize("time", [SECOND, 3 * SECOND // 2, 6 * SECOND + 2, 7_900_000_003])
def test_an_answer_is_whole_until_the_time_that_it_names(replay: Replay, time: int) -> None:
    answer = replay.at(time)
    blocks = replay._packer.blocks
    everything = [(change[0], change[1], change[3]) for block in blocks for change in block.lists["variables"]]
    got = [(change[0], change[1], change[3]) for change in answer["variables"]]
    assert answer["until"] >= time
    assert [change for change in got if change[0] <= answer["until"]] == [
        change for change in everything if answer["start"] <= change[0] <= answer["until"]
    ]


def test_an_answer_does_not_go_far_beyond_the_instant(replay: Replay) -> None:
    answer = replay.at(3 * SECOND // 2)
    later = [change for name in ("variables", "poses") for change in answer[name] if change[0] > 3 * SECOND // 2]
    assert 0 < len(later) < 2 * ROBOTS * 10
    assert 3 * SECOND // 2 < answer["until"] < 5 * SECOND // 2


def test_an_answer_does_not_wait_for_the_acknowledgement_of_its_beginning(replay: Replay) -> None:
    with Server(replay) as server:
        assert server.socket.proto == socket.IPPROTO_TCP  # asyncio then sets TCP_NODELAY on each connection


def test_a_jump_shows_the_instant_everywhere_and_then_also_what_is_out_of_sight(
    chromium: Browser, replay: Replay
) -> None:
    values = "[...document.querySelectorAll('#inspector section')].map((one) => one.querySelector('td code')?.textContent ?? '')"
    with opened(chromium, replay) as page:
        for step in (71, 12, 40):
            page.evaluate(f"fame.player.seek({step} * 1e8 + 50)")
            until(page, f"fame.shows({step} * 1e8 + 50)")
            first = page.evaluate(values)[0]
            assert first == str(step * 100)
            until(page, f"{values}.join() === '{','.join(str(step * 100 + number) for number in range(ROBOTS))}'")
        page.evaluate("document.querySelector('#inspector .body').scrollTo(0, 1e6)")
        page.evaluate("fame.player.seek(33 * 1e8 + 50)")
        until(page, "fame.shows(33 * 1e8 + 50)")
        until(page, f"{values}.at(-1) === '{3300 + ROBOTS - 1}'")
        page.evaluate("fame.select({robot: 3})")
        until(page, "document.querySelector('#inspector td code').textContent === '3303'")
        page.evaluate("fame.select({robot: -1})")
        until(page, f"{values}.length === {ROBOTS}")


def test_a_trail_breaks_where_the_simulation_began_again(chromium: Browser, replay: Replay) -> None:
    way = """(time) => {
      const lines = [];
      fame.world.collect();
      fame.world.along(0, time, (x) => lines.push([x]), (x) => lines.at(-1).push(x));
      return lines.map((line) => [line[0], line.at(-1)]);
    }"""
    with opened(chromium, replay) as page:
        assert page.evaluate(way, 4.05e9) == [[0, 4]]
        assert page.evaluate(way, 7.95e9) == [[0, 4.9], [0, 2.9]]
