"""Recordings that cannot be shown, or only in part: one line that says why."""

from __future__ import annotations

import gc
import json
from contextlib import suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import pytest
from recorded_runs import record
from view_page import opened, says, until

from fame.bpmn.model import Definitions
from fame.bpmn.reader import read
from fame.cli import main
from fame.errors import ConfigError, ModelError
from fame.log import logging_to
from fame.log.recording_file import RecordingFile
from fame.scenario import Scenario
from fame.view import Replay
from fame.view.blocks import Packer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = Scenario.load(EXAMPLES / "ground_vehicles.yaml", duration=60)
    return record(scenario, tmp_path_factory.mktemp("view") / "run.mcap")


def written(path: Path, metadata: dict[str, str], *messages: tuple[str, int, str], models: Any = ()) -> Path:
    """A recording with these messages."""
    with path.open("wb") as stream:
        file = RecordingFile(stream)
        file.describe(metadata)
        for name, data in models:
            file.attach(f"models/{name}", "application/bpmn+xml", data)
        for topic, time, text in messages:
            file.put(topic, time, json.loads(text))
        file.finish()
    return path


def test_a_recording_that_was_cut_short_is_shown_up_to_where_it_is_whole(
    chromium: Browser, recording: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: recording.stat().st_size * 2 // 3])
    with Replay(cut) as replay:
        replay.wait()
        mission = replay.mission()
        assert 10e9 < mission["end"] < 60e9
        assert mission["blocks"][-1][2] <= mission["end"]
        assert len(mission["notices"]) == 1
        with opened(chromium, replay) as page:
            assert page.locator(".notice").inner_text() == mission["notices"][0]


@pytest.mark.parametrize("content", [b"", b"not an MCAP file", b"\x89MCAP0\r\n"])
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"run\.mcap: "):
        Replay(path)


def test_a_newer_format_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", {"format": "99"}, ("/fame/key", 0, '{"robots":{}}'))
    with pytest.raises(ConfigError, match="expected format 2 or older, got format 99"):
        Replay(path)


def test_a_recording_without_models_says_what_is_missing(chromium: Browser, tmp_path: Path) -> None:
    events = '{"robot":"REX","events":[{"instance":1,"scope":2,"marks":[["P","start"],["T","enter"]]}]}'
    path = written(tmp_path / "run.mcap", {}, ("/fame/events", 5, events))
    with Replay(path) as replay:
        replay.wait()
        with opened(chromium, replay) as page:
            assert "The recording has no models" in page.locator("#diagram").inner_text()
            page.evaluate("fame.player.seek(5)")
            assert page.evaluate(
                "[...fame.store.stateAt(5).tokens.values()].map((one) => fame.mission.elements[one.e].id)"
            ) == ["T"]


def test_a_world_of_another_form_does_not_stop_the_page(chromium: Browser, tmp_path: Path) -> None:
    pair = '{"key": "ground", "value": "{\\"obstacles\\": [7]}"}'
    ground = ("/fame/ground", 0, f'{{"deletions": [], "entities": [{{"id": "ground", "metadata": [{pair}]}}]}}')
    opens = '{"robot":"REX","opens":[{"scope":2,"instance":1}],"events":[]}'
    change = '{"robot":"REX","changes":[{"scope":2,"set":{"x":5}}]}'
    messages = ("/fame/key", 0, '{"robots":{}}'), ("/fame/events", 5, opens), ("/fame/variables", 5, change)
    path = written(tmp_path / "run.mcap", {}, ground, *messages)
    with Replay(path) as replay:
        replay.wait()
        with opened(chromium, replay) as page:
            page.evaluate("fame.player.seek(5)")
            until(page, "document.querySelector('#inspector').textContent.includes('x5')")
            says(page, "#toast", "The world cannot be drawn")


def test_a_model_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    key = ("/fame/key", 0, '{"robots":{}}')
    with Replay(written(tmp_path / "run.mcap", {}, key, models=[("broken.bpmn", b"<half a")])) as replay:
        replay.wait()
        assert replay.notices[0].startswith("broken.bpmn is not shown: ")


@pytest.mark.parametrize(
    "runs", ["[1]", "none", '{"REX": 3}', '{"REX": [["a", "P", []]]}', '{"REX": [[1e400, "P", []]]}']
)
def test_models_of_robots_of_another_form_are_left_out_with_a_notice(tmp_path: Path, runs: str) -> None:
    key = ("/fame/key", 0, '{"robots":{}}')
    with Replay(written(tmp_path / "run.mcap", {"models": runs}, key)) as replay:
        replay.wait()
        assert replay.notices[0].startswith("has metadata `models` of another form: ")


@pytest.mark.parametrize(
    "text", ['{"robot":"REX"}', "[]", '{"robot":"REX","events":[{"instance":1}]}', '{"robot":"REX","events":7}']
)
def test_messages_of_another_form_end_the_replay_with_a_notice(tmp_path: Path, text: str) -> None:
    path = written(tmp_path / "run.mcap", {}, ("/fame/events", 5, text))
    with suppress(ConfigError), Replay(path) as replay:  # it may be refused as a whole, in one line
        replay.wait()
        assert "the rest of the recording cannot be shown" in replay.notices[-1]


def test_a_page_is_told_of_any_error_after_which_nothing_more_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It has been loaded before: it shows the notice at once, and no error ends the reader without a word."""
    key, change = ("/fame/key", 0, '{"robots":{}}'), ("/fame/events", 5, '{"robot":"REX","events":[]}')
    read, begun = Event(), Packer.put

    def put(packer: Packer, topic: str, time: int, data: Any) -> None:
        if topic == "/fame/events":
            read.wait(30)
            raise RuntimeError("no block can be made")
        begun(packer, topic, time, data)

    monkeypatch.setattr(Packer, "put", put)
    with Replay(written(tmp_path / "run.mcap", {}, key, change)) as replay:
        known, _ = replay.news(None)
        assert replay.mission()["notices"] == []
        read.set()
        replay.wait()
        known, news = replay.news(known)
        assert news[-1] == {"type": "reload", "version": replay.mission()["version"]}
        why = "the rest of the recording cannot be shown: RuntimeError: no block can be made"
        assert (replay.mission()["notices"], replay.mission()["reading"]) == ([why], 1.0)
        assert replay.news(known) == (known, [])


def test_files_are_closed_when_a_recording_is_refused_and_when_the_block_ends_in_an_error(tmp_path: Path) -> None:
    key = ("/fame/key", 0, '{"robots":{}}')
    path = written(tmp_path / "run.mcap", {}, key)
    with pytest.raises(ZeroDivisionError), Replay(path) as replay:
        raise ZeroDivisionError
    assert replay._recording._stream.closed
    assert replay._ahead._stream.closed
    world = ("/fame/world", 0, '{"transforms": 7}')
    with pytest.raises(ConfigError, match="has messages of another form"):
        Replay(written(path, {}, key, world))  # what it opened and left would be a warning, and thus an error
    gc.collect(1)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["missing.mcap"], "missing.mcap: cannot be read"),
        (["missing.bpmn"], "missing.bpmn: cannot be read: no such file"),
        (["run.txt"], "expected a recording (.mcap), a model (.bpmn) or a scenario (.yaml), got '.txt'"),
        (["run.mcap", "--port", "99999"], "expected a port from 0 to 65535, got '99999'"),
        ([str(EXAMPLES.parent / "models" / "convoy.bpmn"), "--host", "a..b"], "cannot serve the page on a..b port 0: "),
        (["--branch", "3"], "--branch needs a recording"),
        (["run.mcap", "--branch", "0"], "expected a number above 0, got '0'"),
    ],
)
def test_a_wrong_request_is_one_line(words: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", *words, "--no-open"]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


@pytest.mark.long
def test_a_run_that_was_not_recorded_by_the_command_is_not_run_again(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(recording), "--branch", "3", "--no-open"]) == 2
    assert "cannot be run again: it is not a recording of fame run" in capsys.readouterr().err


def test_a_model_that_cannot_be_laid_out_has_its_elements(
    chromium: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = Path(__file__).parent.parent / "models" / "ground_vehicles.bpmn"
    text = bare.read_text(encoding="utf-8")
    start, end = text.index("<bpmndi:BPMNDiagram"), text.index("</bpmndi:BPMNDiagram>") + len("</bpmndi:BPMNDiagram>")
    model = tmp_path / "bare.bpmn"
    model.write_text(text[:start] + text[end:], encoding="utf-8")
    assert not read(model).shapes

    def unable(model: Definitions) -> None:
        raise ModelError("it cannot be laid out")

    monkeypatch.setattr("fame.layout.lay_out", unable)
    scenario, path = Scenario.load(model, duration=1), tmp_path / "run.mcap"
    with logging_to(path, [scenario.definitions]) as log:  # without the behaviours that it calls, which have a diagram
        scenario.run(observer=log)
    with Replay(path) as replay:
        replay.wait()
        with opened(chromium, replay) as page:
            assert "This model has no diagram" in page.locator("#diagram").inner_text()
