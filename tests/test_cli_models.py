"""``fame split``, ``fame check`` and ``fame draw``: what one does with a model before and after a run."""

import json
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from bpmn_text import process
from check_drawing import call, data, given as inputs, row, script, team

import fame
from fame.cli import main
from fame.log.recording_file import RecordingFile

ROOT = Path(__file__).parent.parent
MISSION = str(ROOT / "models" / "ground_vehicles.bpmn")


# ---- split -----------------------------------------------------------------------------------------------------------


def test_split_writes_a_file_per_pool_and_names_it(tmp_path: Path, capsys) -> None:
    assert main(["split", MISSION, "-o", str(tmp_path / "new" / "parts")]) == 0
    files = [tmp_path / "new" / "parts" / name for name in ("REX.bpmn", "DINGO.bpmn")]
    assert capsys.readouterr().out.splitlines() == [str(file) for file in files]
    assert [fame.read(file).participants[0].name for file in files] == ["REX", "DINGO"]


def test_split_as_json(tmp_path: Path, capsys) -> None:
    assert main(["split", MISSION, "-o", str(tmp_path), "--json"]) == 0
    files = {name: str(tmp_path / f"{name}.bpmn") for name in ("REX", "DINGO")}
    assert json.loads(capsys.readouterr().out) == {
        "status": "completed",
        "files": files,
        "needs": {"REX": [], "DINGO": []},
    }


def test_split_names_the_files_that_a_robot_needs_besides(tmp_path: Path, capsys) -> None:
    """What monitors are configured by, what that names, and what services are given; not what they write."""
    stages = "[{Class: power.py:Power}, {Class: Autoencoder, Parameters: {model: ../good.skops}}]"
    port = "{X: {Topic: x, Field: [data], MessageType: std_msgs/msg/Float64}}"
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "unit.yaml").write_text(f"Inputs: {port}\nProcessor: {stages}\n")
    for name in ("conf/power.py", "good.skops", "old.csv"):
        (tmp_path / name).write_text("")
    given = data("goal", configuration="conf/unit.yaml", output="old.csv")
    monitor = given + row(call("c", "Record", inputs("c", "goal")), mark="2")
    (tmp_path / "m.bpmn").write_text(team(row(script("x = 1")), monitor))
    needed = ["conf/unit.yaml", "conf/power.py", "good.skops"]
    assert main(["split", str(tmp_path / "m.bpmn"), "-o", str(tmp_path / "out"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["needs"] == {"REX": [], "DINGO": needed}
    assert err == f"DINGO needs {', '.join(needed)} too, from the folder of its engine (fame engine --files)\n"


def test_each_part_is_self_contained_and_passes_the_check(tmp_path: Path, capsys) -> None:
    assert main(["split", MISSION, "-o", str(tmp_path)]) == 0
    capsys.readouterr()
    assert main(["check", *map(str, sorted(tmp_path.glob("*.bpmn"))), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["errors"] == 0
    calls = {node.called for process in fame.read(tmp_path / "REX.bpmn").processes for node in process.body.walk()
             if hasattr(node, "called")}  # fmt: skip
    assert calls <= {process.id for process in fame.read(tmp_path / "REX.bpmn").processes}


# ---- check -----------------------------------------------------------------------------------------------------------

WRONG = process(
    """<startEvent id="s"/>
<callActivity id="c" calledElement="Fly"/>
<sequenceFlow id="f" sourceRef="s" targetRef="c"/>"""
)


@pytest.fixture
def wrong(tmp_path: Path) -> str:
    """A model that calls what is not there."""
    path = tmp_path / "wrong.bpmn"
    path.write_text(WRONG)
    return str(path)


@pytest.mark.long_but("[a-c]*")
@pytest.mark.parametrize("model", sorted((ROOT / "models").rglob("*.bpmn")), ids=lambda path: path.stem)
def test_the_models_that_come_with_fame_have_neither_errors_nor_warnings(model: Path, capsys) -> None:
    assert main(["check", str(model), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["errors"], told["warnings"]) == (0, 0)


def test_a_finding_is_a_line_in_the_manner_of_compilers(wrong: str, capsys) -> None:
    assert main(["check", wrong]) == 1
    *findings, summary = capsys.readouterr().out.splitlines()
    (error,) = (line for line in findings if ": error: " in line)
    assert error.startswith(f"{wrong}:4: error: c: called element 'Fly'")
    assert summary.startswith("1 error")


def test_findings_as_json_have_place_and_element(wrong: str, capsys) -> None:
    assert main(["check", wrong, "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["status"], told["errors"]) == ("failed", 1)
    (error,) = (finding for finding in told["findings"] if finding["level"] == "error")
    assert (error["file"], error["line"], error["element"]) == (wrong, 4, "c")


def test_a_file_that_cannot_be_read_is_an_error_and_the_others_are_checked(wrong: str, tmp_path: Path, capsys) -> None:
    (tmp_path / "broken.bpmn").write_text("<definitions")
    assert main(["check", str(tmp_path / "broken.bpmn"), wrong, MISSION]) == 1
    out = capsys.readouterr().out
    assert "broken.bpmn:1: error: not well-formed XML" in out
    assert "Fly" in out
    assert out.splitlines()[-1].startswith("2 errors")


# ---- draw ------------------------------------------------------------------------------------------------------------


def test_draw_writes_the_diagram(tmp_path: Path, capsys) -> None:
    path = tmp_path / "out" / "mission.svg"
    assert main(["draw", MISSION, "-o", str(path)]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert ET.parse(path).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert "Explore" in path.read_text()


@pytest.mark.parametrize("ending", ["jsonl", "csv"])
def test_draw_shows_the_path_of_a_run(ending: str, tmp_path: Path) -> None:
    plain, path, log = (tmp_path / name for name in ("plain.svg", "path.svg", f"run.{ending}"))
    assert main(["run", MISSION, "--quiet", "--log", str(log)]) == 1  # without a world nobody publishes a map
    assert main(["draw", MISSION, "-o", str(plain), "--json"]) == 0
    assert main(["draw", MISSION, "-o", str(path), "--log", str(log)]) == 0
    drawn = [
        {group.get("id"): ET.tostring(group) for group in ET.parse(file).iter() if group.get("id")}
        for file in (plain, path)
    ]
    changed = {id for id in drawn[0] if drawn[0][id] != drawn[1][id]}
    assert {"Event_MissionStarts", "Activity_Explore"} <= changed
    assert "Event_DoneCaught" not in changed


def test_a_model_is_converted_to_bpmn_only(tmp_path: Path, capsys) -> None:
    assert main(["convert", MISSION, "-o", str(tmp_path / "c.json")]) == 2
    assert "c.json: expected a file with the ending .bpmn or .xml, got '.json'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_model_is_drawn_again_when_it_was_moved(tmp_path: Path) -> None:
    shutil.copy(MISSION, tmp_path / "alone.bpmn")
    assert main(["draw", str(tmp_path / "alone.bpmn"), "-o", str(tmp_path / "alone.svg")]) == 0


def test_draw_refuses_the_log_of_another_model(tmp_path: Path, capsys) -> None:
    log = tmp_path / "run.jsonl"
    main(["run", MISSION, "--quiet", "--log", str(log)])
    capsys.readouterr()
    assert main(["draw", str(ROOT / "models" / "shuttle.bpmn"), "-o", str(tmp_path / "x.svg"), "--log", str(log)]) == 2
    assert "belongs to another model" in capsys.readouterr().err
    assert not (tmp_path / "x.svg").exists()


def test_a_recording_is_drawn_as_a_film_or_its_last_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, film, picture = (tmp_path / name for name in ("run.mcap", "run.gif", "run.png"))
    example = str(ROOT / "examples" / "ground_vehicles.yaml")
    drawn = tmp_path / "drawn.gif"
    assert main(["run", example, "--duration", "1", "--log", str(run), "--animate", str(drawn), "--quiet"]) == 1
    capsys.readouterr()
    for path in (film, picture):
        assert main(["draw", "--log", str(run), "-o", str(path)]) == 0
        assert capsys.readouterr().out == f"{path}\n"
    assert film.read_bytes().startswith(b"GIF89a")
    assert len(film.read_bytes()) == pytest.approx(drawn.stat().st_size, rel=0.1)  # another title
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["-o", "x.gif"],
            "x.gif: is made of a recording: expected RUN.mcap, without a model and --robot; a model is drawn as .svg",
        ),
        (["-o", "x.png", "--log", "run.jsonl"], "x.png: is made of a recording: expected RUN.mcap"),
        (["-o", "x.gif", MISSION, "--log", "run.mcap"], "x.gif: is made of a recording: expected RUN.mcap"),
        (["-o", "x.gif", "--log", "gone.mcap"], "gone.mcap: cannot be read"),
        (["-o", "x.gif", "--log", "alone.mcap"], "alone.mcap: has neither a drawn diagram nor a simulated world"),
        (["-o", "x.svg"], "x.svg: expected a model to draw"),
    ],
)
def test_what_a_film_needs_is_named(
    words: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with Path("alone.mcap").open("wb") as stream:
        file = RecordingFile(stream)
        file.describe({})
        file.finish()
    assert main(["draw", *words]) == 2
    assert text in capsys.readouterr().err
