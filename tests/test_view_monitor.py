"""Alarms of a model on the page of a recording: what the channels did, in the band of the training runs."""

from __future__ import annotations

import json
import re
import shutil
from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from monitor_runs import told
from recorded_runs import record
from test_view_server import ask
from view_page import frames, opened, says, until

from fame.cli import main
from fame.cli.monitor.labelling import label_on_page
from fame.cli.monitor.models import judged_on_page
from fame.cli.network import person
from fame.errors import FameError
from fame.log import Recording
from fame.monitor.data_files import read_labelled_runs
from fame.monitor.labels import read_labels
from fame.monitor.pipeline.trained_model import TrainedModel
from fame.scenario import Fault, Scenario
from fame.view import Replay, Server
from fame.view.people import Person

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parent.parent
JOINT = "Efforts.shoulder_pan_joint"


def recorded(path: Path, seed: int, **options: Any) -> Path:
    """The first seconds of a reassembly, with the topics of the arm."""
    scenario = Scenario.load(ROOT / "examples" / "reassembly.yaml", seed=seed, duration=8, **options)
    return record(scenario, path, topics="all")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of two undisturbed runs, and the recording of a third in which something holds the shoulder."""
    folder = tmp_path_factory.mktemp("alarms")
    source = yaml.safe_load((ROOT / "models" / "monitoring" / "joint_monitor" / "low_pass.yaml").read_text())
    training = {"Files": ["runs.csv"], "Model": "m.skops", "Detector": "pca", "Before": 20, "Cutoff": 5, "Folds": 2}
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(source | {"Training": training}))
    for seed in (1, 2):
        run = recorded(folder / f"{seed}.mcap", seed)
        words = ("--namespace", "Arm", "--bag", str(run), "-o", str(folder / "runs.csv"), "--append")
        assert main(["monitor", "record", str(config), *words]) == 0
    assert main(["monitor", "train", str(config)]) == 0
    recorded(folder / "held.mcap", 4, faults=[Fault("Arm", 6.5, "blocked_shoulder")])
    return folder


def judged(folder: Path, capsys: pytest.CaptureFixture[str], run: str) -> tuple[int, Any]:
    words = ("--config", folder / "config.yaml", "--namespace", "Arm")
    return told(capsys, "monitor", "judge", folder / "m.skops", folder / run, *words)


def shown(folder: Path, run: Path) -> dict[str, Any]:
    return judged_on_page(folder / "m.skops", run, asked(folder))


def asked(folder: Path) -> Namespace:
    return Namespace(config=folder / "config.yaml", namespace="Arm", topic="")


def test_a_recording_of_fame_is_judged_by_the_topics_that_it_has(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = judged(folder, capsys, "held.mcap")
    assert code == 1
    assert any(text.startswith(JOINT) for text in found["runs"][0]["events"][0]["explanations"])
    assert judged(folder, capsys, "1.mcap")[0] == 0
    without = ("monitor", "judge", str(folder / "m.skops"), str(folder / "held.mcap"))
    assert main([*without, "--config", str(folder / "config.yaml")]) == 2
    assert "has no topic /joint_states; it has /Arm/" in capsys.readouterr().err


def test_the_active_elements_of_a_recording_of_fame_are_known(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--namespace", "Arm", "--bag", str(folder / "1.mcap"), "-o", str(tmp_path / "run.csv"), "--elements")
    assert main(["monitor", "record", str(folder / "config.yaml"), *words]) == 0
    capsys.readouterr()
    (run,) = read_labelled_runs([tmp_path / "run.csv"])
    there = [(stamp, name) for stamp, name in run.samples.elements if name == "Event_Re_There"]
    with Recording(folder / "1.mcap") as recording:
        entered = [e.time / 1e9 for e in recording.events() if (e.element, e.what) == ("Event_Re_There", "enter")]
    assert [stamp for stamp, _ in there] == pytest.approx(entered, abs=0.005)
    assert len(there) > 2
    model = TrainedModel.load(folder / "m.skops")
    replace(model, elements={"sort": (0.0, 9.0)}).save(tmp_path / "sorting.skops")
    code, found = told(
        capsys, "monitor", "judge", tmp_path / "sorting.skops", folder / "1.mcap", "--namespace", "Arm",
        "--config", folder / "config.yaml",
    )  # fmt: skip
    assert (code, found["runs"][0]["verdict"]) == (3, "not judged")


@pytest.mark.long
def test_recordings_of_fame_train_with_their_active_elements(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = ("--data", folder / "1.mcap", folder / "2.mcap", "--config", folder / "config.yaml", "--namespace", "Arm")
    code, found = told(
        capsys, "monitor", "train", *data, "--elements", "--detector", "phase", "-o", tmp_path / "m.skops"
    )
    assert (code, JOINT in found["columns"]) == (0, True)
    assert not any("failed" in text for text in found["warnings"])
    known = TrainedModel.load(tmp_path / "m.skops")
    assert "Event_Re_There" in known.elements
    replace(TrainedModel.load(folder / "m.skops"), elements=known.elements, band=known.band).save(tmp_path / "n.skops")
    monitor = judged_on_page(tmp_path / "n.skops", folder / "held.mcap", asked(folder))
    said = [re.match(rf"{JOINT} in (\w+): ", text) for alarm in monitor["alarms"] for text in alarm["text"]]
    assert {each[1] for each in said if each} & known.elements.keys()


def test_what_an_incomplete_recording_does_not_show_is_not_benign(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (folder / "1.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    code, found = judged(folder, capsys, str(cut))
    (run,) = found["runs"]
    assert (code, run["verdict"], run["events"]) == (3, "not judged", [])
    assert run["notes"][-1] == "the recording is incomplete: how the run went on is not known"


def test_a_recording_that_is_shorter_than_a_window_is_not_judged_on_the_page(folder: Path, tmp_path: Path) -> None:
    scenario = Scenario.load(ROOT / "examples" / "reassembly.yaml", duration=0.05)
    record(scenario, tmp_path / "short.mcap", topics="all")
    monitor = shown(folder, tmp_path / "short.mcap")
    assert (monitor["verdicts"], monitor["channels"]) == (["not judged"], [])
    with Replay(tmp_path / "short.mcap", monitor=monitor) as replay:
        assert [text for text, *_ in replay.mission()["chips"] if "judged" in text] == ["not judged"]


def test_a_recording_without_the_topics_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "text.mcap").write_text("hello")
    for name in ("text.mcap", "runs.csv"):
        assert main(["view", str(folder / name), "--monitor", str(folder / "m.skops"), "--no-open"]) == 2
    for subject in (
        [str(ROOT / "models" / "reassembly.bpmn")],
        [str(folder)],
        [],
        [str(folder / "1.mcap"), "--branch", "1"],
    ):
        assert main(["view", *subject, "--monitor", str(folder / "m.skops")]) == 2
        assert capsys.readouterr().err.endswith("--monitor judges a recording (RUN.mcap), without --branch\n")
    assert main(["view", str(folder / "1.mcap"), "--config", str(folder / "config.yaml")]) == 2
    assert "--config says what --monitor MODEL.skops reads" in capsys.readouterr().err


def labelling(folder: Path, run: Path) -> Replay:
    """The page of a recording whose alarms can be called false."""
    label = partial(label_on_page, folder / "m.skops", run, asked(folder))
    return Replay(run, monitor=shown(folder, run), label=label)


@pytest.fixture
def labels(folder: Path) -> Iterator[Callable[[], list[tuple[str, ...]]]]:
    """What was said of runs: label, who, number; gone after the test."""

    def said() -> list[tuple[str, ...]]:
        return [(each["label"], each["who"], each["run"]) for each in read_labels(folder / "m.skops").values()]

    yield said
    (folder / "m.labels.json").unlink(missing_ok=True)
    shutil.rmtree(folder / "m.labels", ignore_errors=True)


def test_an_alarm_that_was_false_goes_into_the_next_training(
    folder: Path, labels: Callable[[], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    with labelling(folder, folder / "held.mcap") as replay:
        assert replay.mission()["control"] == ["label"]
        assert {alarm["run"] for alarm in replay.mission()["monitor"]["alarms"]} == {0}
        said = replay.control({"do": "label", "run": 0, "who": "ann (operator)"})["said"]
        for run, reason in ((1, "has no run 1; it has 1"), ("0", "expected the number of a run"), (-1, "got -1")):
            with pytest.raises(FameError, match=reason):
                replay.control({"do": "label", "run": run})
    assert said == f"The run is benign: fame monitor retrain {folder / 'm.skops'} uses that."
    assert labels() == [("benign", "ann (operator)", "0")]
    before = TrainedModel.load(folder / "m.skops").conditions["runs"]
    shutil.copytree(folder / "m.labels", folder / "n.labels")
    shutil.copy(folder / "m.labels.json", folder / "n.labels.json")
    shutil.copy(folder / "m.skops", folder / "n.skops")
    words = ["monitor", "retrain", str(folder / "n.skops"), "--data", str(folder / "runs.csv"), "--keep"]
    assert main(words) == 0
    assert "ann (operator)" in capsys.readouterr().out
    assert TrainedModel.load(folder / "n.skops").conditions["runs"] == before + 1


def test_a_recording_gets_and_loses_its_label_by_commands(folder: Path, labels: Callable[[], Any]) -> None:
    run, model = str(folder / "held.mcap"), ("--model", str(folder / "m.skops"))
    read = ("--config", str(folder / "config.yaml"), "--namespace", "Arm")
    assert main(["monitor", "label", run, "--benign", *model]) == 2  # nobody says what of it is read
    assert main(["monitor", "label", run, "--benign", "--by", "ann", *model, *read]) == 0
    assert labels() == [("benign", "ann", "0")]
    assert main(["monitor", "label", run, "--remove", *model]) == 0
    assert labels() == []


def test_who_may_only_complete_tasks_labels_nothing(folder: Path, labels: Callable[[], Any]) -> None:
    ann, command = Person("ann", "operator"), json.dumps({"do": "label", "run": 0, "who": "the director"})
    with labelling(folder, folder / "held.mcap") as replay, Server(replay, people=[ann]) as server:

        def answer(token: str | None) -> tuple[int, bytes]:
            status, _, content = ask(server, "/control", "POST", token=token, body=command)
            return status, content

        assert json.loads(ask(server, "/mission.json", token=ann.token)[2])["control"] == []
        status, content = answer(ann.token)
        assert (status, b"may only complete tasks" in content) == (409, True)
        assert answer("guessed")[0] == 404
        assert labels() == []
        assert answer(None)[0] == 200
    ((_, who, _),) = labels()
    assert who == person()  # not what the page says


def test_a_page_without_alarms_and_one_that_is_a_file_have_no_button(folder: Path) -> None:
    with labelling(folder, folder / "1.mcap") as replay:
        assert replay.mission()["control"] == []
    with Replay(folder / "held.mcap", monitor=shown(folder, folder / "held.mcap")) as replay:
        assert replay.mission()["control"] == []


def test_the_button_says_what_was_false_and_labels_it(
    chromium: Browser, folder: Path, labels: Callable[[], Any]
) -> None:
    with labelling(folder, folder / "held.mcap") as replay, opened(chromium, replay) as page:
        page.get_by_role("button", name="Alarm was false …").click()
        dialog = page.get_by_role("dialog", name="Was the alarm false?")
        assert JOINT in dialog.inner_text()
        dialog.get_by_role("button", name="The run was benign").click()
        says(page, "#toast", "The run is benign: fame monitor retrain")
    assert labels() == [("benign", person(), "0")]


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)], ids=["wide", "phone"])
def test_an_alarm_and_the_band_of_its_channel_are_on_the_page(
    chromium: Browser, folder: Path, size: tuple[int, int]
) -> None:
    monitor = shown(folder, folder / "held.mcap")
    names = [each["name"] for each in json.loads(json.dumps(monitor))["channels"]]
    assert JOINT in names
    narrow = size[0] < 1101  # one panel at a time
    viewport = {"width": size[0], "height": size[1]}
    with Replay(folder / "held.mcap", monitor=monitor) as replay, opened(chromium, replay, viewport=viewport) as page:
        if narrow:
            page.get_by_role("tab", name="Log").click()
        until(page, f"document.querySelectorAll('.lane.plot').length === {len(names)}")
        assert [each.get_attribute("title") for each in page.locator(".lane.plot b").all()] == names
        assert page.locator("#chips .failed").inner_text() == "1 alarm"
        left, top, wide, high = until(page, "fame.timeline.hits.findLast((hit) => hit.alarm)?.box")
        assert left > 0.7 * page.evaluate("fame.timeline.width")  # the fault came at 6.5 s of 8
        page.evaluate("(top) => { fame.timeline.scroller.scrollTop = top; }", top)
        frames(page)
        box = page.locator("canvas.lanes").bounding_box()
        scroll = page.evaluate("fame.timeline.scroller.scrollTop")
        assert box is not None
        page.mouse.move(box["x"] + left + wide / 2, box["y"] + top + high / 2 - scroll)
        tip = until(page, "!fame.timeline.tip.hidden && fame.timeline.tip.innerText")
        assert JOINT in tip
        assert "in training" in tip
