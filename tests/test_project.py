"""A project: `fame new` writes it, and commands take from its `fame.yaml` what their command line does not say."""

import json
import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest
import yaml
from bpmn_text import process
from fame_test_runs import fame_test

from fame.cli import main, parser, project
from fame.log import Recording

ROOT = Path(__file__).parent.parent
EXAMPLES = [path for path in sorted(ROOT.glob("examples/*.yaml")) if "\nmodel: " in path.read_text(encoding="utf-8")]
CALLS = process(
    '<startEvent id="S"/><callActivity id="C" calledElement="Beep"/><endEvent id="E"/>'
    '<sequenceFlow id="F1" sourceRef="S" targetRef="C"/><sequenceFlow id="F2" sourceRef="C" targetRef="E"/>'
)
BEEP = process(
    '<startEvent id="BS"/><scriptTask id="BT"><script>robot.publish("beep", "own_msgs/msg/Beep", count=1)</script>'
    '</scriptTask><sequenceFlow id="B1" sourceRef="BS" targetRef="BT"/>'
).replace('id="P"', 'id="Beep"')


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder that is the current one, with a .git so that no project above it counts."""
    (tmp_path / ".git").mkdir()
    inside = tmp_path / "work"
    inside.mkdir()
    monkeypatch.chdir(inside)
    return inside


@pytest.fixture
def team(folder: Path) -> Path:
    """A project whose model calls a process of its library, which publishes one of its message types."""
    for path, text in {
        "fame.yaml": "name: own\nscenarios: [calls.bpmn]\nlibrary: [behaviours]\ntypes: [msgs]\n",
        "calls.bpmn": CALLS,
        "behaviours/Beep.bpmn": BEEP,
        "msgs/own_msgs/msg/Beep.msg": "int32 count\n",
        "tests/test_it.py": 'def test_it(mission):\n    mission.load("calls.bpmn").expect().completed()\n',
    }.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    return folder


# ---- fame new --------------------------------------------------------------------------------------------------------


def test_a_new_project_checks_runs_and_passes_its_tests_without_arguments(folder: Path, monkeypatch, capsys) -> None:
    assert main(["new", "hospital"]) == 0
    printed = capsys.readouterr().out
    written = files(folder / "hospital")
    assert written >= {"fame.yaml", "mission.bpmn", "mission.yaml", "tests/test_mission.py", ".gitignore"}
    assert all(f"hospital/{name}\n" in printed for name in written)
    assert json.loads((folder / "hospital" / ".camunda" / "element-templates" / "publish.json").read_text())
    monkeypatch.chdir(folder / "hospital" / "tests")
    assert main(["check"]) == 0
    assert main(["run", "--quiet"]) == 0
    code, shown = fame_test()
    assert code == 0, shown
    assert "3 passed" in shown
    assert "total: 100.0 %" in shown


@pytest.mark.long
def test_the_page_on_projects_lets_a_test_fail_and_mends_the_mission(folder: Path) -> None:
    main(["new", "hospital", "--json"])
    os.chdir(folder / "hospital")
    change, mend = re.findall(r"^sed .*$", (ROOT / "docs" / "projects.md").read_text(encoding="utf-8"), re.MULTILINE)
    subprocess.run(change, shell=True, check=True)
    code, shown = fame_test()
    assert code == 1
    assert (
        "SCOUT  at Gateway_Reply since 8 s, waits for topic /joined, which no other node publishes, or timer" in shown
    )
    subprocess.run(mend, shell=True, check=True)
    assert fame_test()[0] == 0


@pytest.mark.parametrize("name", ["2024", "no", "null", "1.5", "Krankenhaus_Süd"])
def test_a_name_that_yaml_takes_for_something_else_is_a_name(name: str, folder: Path, monkeypatch) -> None:
    assert main(["new", name]) == 0
    monkeypatch.chdir(folder / name)
    assert main(["check", "--json"]) == 0
    assert project.read(Path("fame.yaml")).name == name


@pytest.mark.long
def test_tests_that_leave_an_element_out_fail_a_project_and_a_selection_of_them_does_not(folder: Path) -> None:
    main(["new", "hospital", "--json"])
    os.chdir(folder / "hospital")
    assert fame_test("-k", "world")[0] == 0
    path = Path("tests/test_mission.py")
    path.write_text(path.read_text(encoding="utf-8").replace("def test_a_scout_that_finds", "def a_scout_that_finds"))
    code, shown = fame_test()
    assert code == 1
    assert "is below 100 %" in shown


def test_the_workflow_of_a_new_project_runs_commands_that_exist() -> None:
    (path,) = (ROOT / "examples" / "project" / ".github" / "workflows").iterdir()
    steps = yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"]["mission"]["steps"]
    said = [step["run"] for step in steps if step.get("run", "").startswith("fame ")]
    assert said == ["fame check", "fame test", "fame run --quiet"]
    assert all(parser().parse_args(words.split()[1:]).command for words in said)


@pytest.mark.long
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_copied_with_all_that_it_needs(example: Path, folder: Path, monkeypatch) -> None:
    assert main(["new", "--from", "example", example.stem]) == 0
    copied = folder / example.stem
    named = f"examples/{example.name}", f"models/{example.stem}.bpmn"
    own = {name for name in named if (ROOT / name).is_file()}
    assert own <= files(copied)
    monkeypatch.chdir(copied)
    assert main(["check"]) == 0
    code, shown = fame_test("-k", "not in_the_world")
    assert code == 0, shown


@pytest.mark.parametrize("words", ["--from shuttle taxi", "taxi --from shuttle", "--from example shuttle taxi"])
def test_the_name_of_a_project_comes_before_or_after_its_example(words: str, folder: Path) -> None:
    assert main(["new", *words.split()]) == 0
    assert (folder / "taxi" / "examples" / "shuttle.yaml").is_file()


def test_a_project_that_learns_installs_what_it_learns_with(folder: Path) -> None:
    for example, extras in (("sabotage", "[sim,ml,test]"), ("reassembly", "[sim,ml,test]"), ("shuttle", "[sim,test]")):
        assert main(["new", "--from", example]) == 0
        assert f".whl){extras}" in (folder / example / ".github" / "workflows" / "mission.yml").read_text().replace(
            '"', ""
        )


# ---- fame.yaml -------------------------------------------------------------------------------------------------------


def test_the_project_is_named_first_and_in_json(team: Path, monkeypatch, capsys) -> None:
    inner = team / "behaviours"
    monkeypatch.chdir(inner)
    assert main(["run"]) == 0
    assert capsys.readouterr().err.splitlines()[0] == f"fame: project own: {team / 'fame.yaml'}"
    assert main(["run", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["project"] == {"name": "own", "file": str(team / "fame.yaml")}
    assert err == ""
    assert main(["check", "--no-project", str(team / "calls.bpmn"), "--json"]) == 1  # the library is not known
    assert "project" not in json.loads(capsys.readouterr().out)


def test_library_and_types_of_a_project_hold_for_its_tests(team: Path) -> None:
    code, shown = fame_test("tests")
    assert code == 0, shown
    assert fame_test("tests", "--no-project")[0] == 1


def test_its_library_holds_for_what_judges_its_properties(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (team / "calls.yaml").write_text("model: calls.bpmn\nduration: 5\nproperties: {ends: P completes}\n")
    assert main(["run", "calls.yaml", "--quiet", "--log", "run.mcap"]) == 0
    assert main(["log", "judge", "calls.yaml", "run.mcap"]) == 0
    assert re.search("ends +holds", capsys.readouterr().out)
    assert main(["log", "judge", "--no-project", "--library", "behaviours", "calls.yaml", "run.mcap"]) == 0
    assert main(["log", "judge", "--no-project", "calls.yaml", "run.mcap"]) == 2


def test_the_command_line_wins(team: Path, tmp_path: Path) -> None:
    (team / "fame.yaml").write_text(
        "scenarios: [calls.bpmn]\nmiddleware: zenoh\nkeys: {sign: a.key, trust: [a.pub]}\nlibrary: [behaviours]\n"
    )
    for name in ("a.key", "b.key", "a.pub"):
        (team / name).touch()

    def given(*words: str):
        arguments = parser().parse_args(words)
        arguments.command_line = ""
        project.apply(arguments)
        return arguments

    deployed = given("deploy", "calls.bpmn")
    assert (deployed.middleware, deployed.key, deployed.library) == ("zenoh", Path("a.key"), [Path("behaviours")])
    own = given("deploy", "calls.bpmn", "--middleware", "dds", "--key", "b.key", "--library", "msgs")
    assert (own.middleware, own.key, own.library) == ("dds", Path("b.key"), [Path("msgs"), Path("behaviours")])
    assert given("engine", "REX").trust == [Path("a.pub")]
    assert given("engine", "REX", "--insecure").trust == []
    simulated = given("run")
    assert (simulated.middleware, simulated.key, simulated.scenario) == ("local", None, Path("calls.bpmn"))
    assert given("run", "--middleware", "dds").key == Path("a.key")
    assert (given("view").middleware, given("view").key, given("view", "--control").key) == (
        "zenoh",
        None,
        Path("a.key"),
    )
    assert given("keys", "new", "team").key is None


def test_a_recording_has_a_command_that_does_the_same_anywhere(team: Path, tmp_path: Path, monkeypatch) -> None:
    assert main(["run", "--log", "run.mcap", "--seed", "3", "--set", "x=-1"]) in (0, 2)
    assert main(["run", "--log", "run.mcap", "--seed", "3"]) == 0
    with Recording(team / "run.mcap") as recording:
        command = shlex.split(recording.metadata["command"])
    assert command[:3] == ["fame", "run", str(team / "calls.bpmn")]
    assert {"--no-project", "--seed=3", f"--library={team / 'behaviours'}", f"--types={team / 'msgs'}"} <= {*command}
    monkeypatch.chdir(tmp_path)
    assert main([*command[1:], "--quiet"]) == 0


@pytest.mark.long
def test_a_campaign_has_commands_that_do_the_same_anywhere(team: Path, tmp_path: Path, monkeypatch) -> None:
    assert main(["campaign", "--runs", "2", "--jobs", "1", "-o", "out"]) == 0
    row = json.loads((team / "out" / "runs.jsonl").read_text().splitlines()[0])
    assert row["status"] == "completed"
    monkeypatch.chdir(tmp_path)
    assert main([*shlex.split(row["command"])[1:], "--quiet"]) == 0
    assert main(["campaign", "--resume", str(team / "out")]) == 0


def test_a_project_is_looked_for_up_to_a_repository_or_home(folder: Path, monkeypatch) -> None:
    (folder / "fame.yaml").touch()
    (folder / "a" / "b").mkdir(parents=True)
    assert project.find(folder / "a" / "b") == folder / "fame.yaml"
    (folder / "a" / ".git").touch()
    assert project.find(folder / "a" / "b") is None
    (folder / "a" / ".git").unlink()
    monkeypatch.setenv("HOME", str(folder / "a"))
    assert project.find(folder / "a" / "b") is None
    assert project.find(Path("/proc/1")) is None  # an end of a file system


def test_the_file_of_another_user_is_refused(team: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: (team / "fame.yaml").stat().st_uid + 1)
    assert main(["check"]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"fame: error: {team / 'fame.yaml'}: belongs to another user")
    assert err.count("\n") == 1
    assert main(["check", "--no-project", "calls.bpmn", "--library", "behaviours", "--types", "msgs"]) == 0


# ---- mistakes of newcomers -------------------------------------------------------------------------------------------

WRONG_FILES = {
    "a misspelt key": ("scenarois: [a.yaml]", ":1: scenarois: unknown key; did you mean 'scenarios'?"),
    "a misspelt key of keys": ("keys: {sing: a.key}", ":1: keys.sing: unknown key; did you mean 'sign'?"),
    "a file that is not there": (
        "\nscenarios: [call.bpmn]",
        ":2: scenarios[0]: there is no 'call.bpmn'; did you",
    ),
    "a folder that is not there": ("library: [behavior]", ":1: library[0]: there is no 'behavior'; did you mean"),
    "a text instead of a list": ("scenarios: calls.bpmn", ":1: scenarios: expected a list, got 'calls.bpmn'"),
    "a number in a list": ("types: [3]", ":1: types[0]: expected a text, got 3"),
    "a middleware that is none": ("middleware: mqtt", ":1: middleware: expected dds, zenoh or ros, got 'mqtt'"),
    "coverage as a text": ("coverage: full", ":1: coverage: expected a number from 0 to 100, got 'full'"),
    "a name that is a list": ("name: [a, b]", ":1: name: expected a text, got ['a', 'b']"),
    "a list": ("- scenarios", "fame.yaml:1: expected a mapping of keys to values, got ['scenarios']"),
    "a tab": ("scenarios:\n\t- a", "fame.yaml:2: is not valid YAML"),
    "no UTF-8": (b"name: \xff", "fame.yaml: is not UTF-8 text"),
    "a scenario": ("model: calls.bpmn", "fame.yaml: is a scenario, which is for fame run"),
    "nothing": ("", "fame.yaml: names no scenarios: expected scenarios: [FILE.yaml], or FILE"),
    "a key given twice": ("name: a\nname: b", ":2: name: is given twice"),
}


@pytest.mark.parametrize("wrong", WRONG_FILES)
def test_a_wrong_file_is_one_line_with_what_would_be_right(wrong: str, team: Path, capsys) -> None:
    text, said = WRONG_FILES[wrong]
    (team / "fame.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    assert main(["check"]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_a_folder_and_a_dangling_link_of_that_name_are_one_line(folder: Path, capsys) -> None:
    (folder / "fame.yaml").mkdir()
    assert main(["run"]) == 2
    assert "fame.yaml: expected a file, got a folder; fame new NAME writes a project\n" in capsys.readouterr().err
    (folder / "fame.yaml").rmdir()
    (folder / "fame.yaml").symlink_to("nowhere")
    assert main(["run"]) == 2
    assert "fame.yaml: No such file or directory\n" in capsys.readouterr().err


REQUESTS = {
    "no name": ("new", "expected a name for the project, as in fame new hospital"),
    "a space": ("new 'my hospital'", "expected a name of letters, digits, _ and -, such as my_hospital, got 'my hos"),
    "a slash": ("new a/b", "such as b, got 'a/b'"),
    "an option's name": ("new -- -x", "such as x, got '-x'"),
    "a folder with files": ("new full", "full: expected a new or an empty folder: this one has files"),
    "a file": ("new plain", "plain: expected the name of a new folder: there is a file of this name"),
    "no such example": ("new --from example warehose", "there is no example 'warehose'; did you mean 'warehouse'?"),
    "no such kind": ("new --from exampel warehouse", "there is no example 'exampel'; "),
    "two examples": ("new --from warehouse shuttle depot", "as in --from example warehouse, got 'warehouse'; "),
    "run outside of a project": ("run", "expected SCENARIO.yaml|MODEL.bpmn, or a project here or above (fame.yaml; "),
    "check outside of a project": ("check", "expected FILE, or a project here or above"),
    "the project as a scenario": ("run --no-project plain.yaml", "plain.yaml: is a project, which is for fame run"),
}


@pytest.mark.parametrize("wrong", REQUESTS)
def test_a_wrong_request_is_one_line_with_what_would_be_right(wrong: str, folder: Path, capsys) -> None:
    words, said = REQUESTS[wrong]
    (folder / "full").mkdir()
    (folder / "full" / "x").touch()
    (folder / "plain").touch()
    (folder / "plain.yaml").write_text("scenarios: [x.yaml]\n")
    before = files(folder)
    assert main(shlex.split(words)) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert files(folder) == before


def test_a_project_inside_of_another_is_refused_unless_it_is_meant(team: Path, capsys) -> None:
    assert main(["new", "inner"]) == 2
    assert "fame.yaml: is a project already: add scenarios to it, or go" in capsys.readouterr().err
    assert main(["new", "inner", "--no-project"]) == 0


def test_a_folder_that_cannot_be_written_is_named(monkeypatch, capsys) -> None:
    monkeypatch.chdir("/proc")
    assert main(["new", "hospital"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("fame: error: hospital: the folder /proc cannot be written (")
    assert err.endswith("): change to one of yours\n")


WRONG_SCENARIOS = {
    "a model that is not there": ("model: call.bpmn", "/a.yaml:1: model: expected a file, relative to the folder"),
    "a misspelt model": ("model: cals.bpmn", "got 'cals.bpmn'; did you mean 'calls.bpmn'?"),
    "robots beside the world": ("robots: {}", "/a.yaml:2: robots: is a key of the world: expected it below world"),
    "a misspelt radius": ("world: {size: [9, 9], obstacles: [{at: [1, 1], raduis: 1}]}", "did you mean 'radius'?"),
    "round brackets": ("world: {size: (9, 9)}", "world.9): unknown key; expected square brackets around a list"),
    "no colon": ("seed 1\nduration: 9", "/a.yaml:2: is not valid YAML: could not find expected ':'"),
    "a unit": ("duration: 9 s", "/a.yaml:2: duration: expected a number above 0, got '9 s'"),
}


@pytest.mark.parametrize("wrong", WRONG_SCENARIOS)
def test_a_wrong_scenario_is_one_line_with_what_would_be_right(wrong: str, team: Path, capsys) -> None:
    text, said = WRONG_SCENARIOS[wrong]
    (team / "a.yaml").write_text(text if text.startswith("model") else f"model: calls.bpmn\n{text}\n")
    assert main(["run", str(team / "a.yaml")]) == 2
    err = capsys.readouterr().err.splitlines()
    assert said in err[-1]
    assert all(line.startswith("fame: project own") for line in err[:-1])


WRONG_FILES_OF_COMMANDS = {
    "a scenario to draw": ("draw a.yaml -o a.svg", "a.yaml: expected a model (.bpmn), such as the one that a scenario"),
    "a scenario to deploy": (
        "deploy a.yaml",
        "a.yaml: expected a model (.bpmn), such as the one that a scenario names",
    ),
    "a scenario to test": ("test a.yaml", "a.yaml: expected tests (.py): fame run and fame check take scenarios and"),
    "a misspelt test": ("test test_at.py", "No such file or directory; did you mean 'test_it.py'?"),
    "a misspelt scenario": (
        "run aa.yaml",
        "aa.yaml: cannot be read: No such file or directory; did you mean 'a.yaml'?",
    ),
    "a misspelt model": ("check cals.bpmn", "cals.bpmn: there is no such file; did you mean 'calls.bpmn'?"),
    "a misspelt recording": (
        "view runn.mcap",
        "runn.mcap: cannot be read: No such file or directory; did you mean 'run",
    ),
    "no recording's ending": ("run a.yaml --log out", "one of .jsonl, .csv, .xes, .mcap, got 'out'"),
    "no action": ("keys", "the following arguments are required: new|robot|diagram, NAME (see fame keys --help)"),
    "a misspelt pattern": ("new x --no-project --from cookbook acution", "did you mean 'auction'?"),
}


@pytest.mark.parametrize("wrong", WRONG_FILES_OF_COMMANDS)
def test_a_wrong_file_of_a_command_is_one_line_with_what_would_be_right(wrong: str, team: Path, capsys) -> None:
    words, said = WRONG_FILES_OF_COMMANDS[wrong]
    for name in ("run.mcap", "test_it.py"):
        (team / name).touch()
    (team / "a.yaml").write_text("model: calls.bpmn\n")
    assert main(shlex.split(words)) == 2
    err = capsys.readouterr().err.splitlines()
    assert said in err[-1]
    assert all(line.startswith("fame: project own") for line in err[:-1])
