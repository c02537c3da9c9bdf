"""The `fame` command as a whole: help, version, and how it ends when something is in its way."""

import json
import os
import shutil
import signal
import subprocess
import sys
from io import StringIO
from pathlib import Path

import pytest
from fame_test_runs import fame_test

from fame import __version__
from fame.__main__ import main as begin
from fame.cli import NAMES, main, parser, run as run_command
from fame.cli.output import coloured, table, table_within

ROOT = Path(__file__).parent.parent


def fame(*arguments: str, **options) -> subprocess.CompletedProcess[str]:
    """The real command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "fame", *arguments], cwd=ROOT, text=True, stderr=subprocess.PIPE, check=False, **options
    )


MONITORS = ("record", "train", "process", "judge", "model", "export", "label", "retrain", "adm")
LOGS = ("record", "convert", "merge", "judge")


def test_help_is_one_screen_with_all_commands_in_groups(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 100
    rooms = lines.index("of parts that an installation may lack:")
    parts = [
        part.replace("|", " | ").split() for line in lines[rooms + 1 : -2] for part in line.partition(":")[0].split(";")
    ]
    assert {words[0] for words in parts} == {
        "view", "draw", "campaign", "inventory", "doctor", "edit", "diff", "test", "monitor", "topic", "param",
        "router", "unit",
    }  # fmt: skip
    core = [line.split() for line in lines[:rooms] if line.startswith(" ")]
    commands = [words[:1] if words[0] == "log" or words[1][0].isupper() else words for words in core]
    assert sorted(name for words in [*commands, *(part[:1] for part in parts)] for name in words) == sorted(
        name for name in NAMES if name != "team"
    )
    assert [words[1::2] for words in [*core, *parts] if words[0] in ("monitor", "log")] == [[*LOGS], [*MONITORS]]


@pytest.mark.parametrize("group", ["team", "monitor", "log"])
def test_a_group_alone_lists_its_commands(group: str, capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main([group])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: fame {group} ")


def test_commands_of_a_team_have_two_faces_and_say_nothing_of_it(capsys) -> None:
    for words in (["keys", "robot", "x"], ["team", "keys", "robot", "x"]):
        assert main(words) == 2
        assert capsys.readouterr().err == "fame: error: fame keys robot needs --key FILE.key, the key of the team\n"
    assert main(["team", "sattus"]) == 2
    assert "did you mean 'status'? (see fame team --help)\n" in capsys.readouterr().err


@pytest.mark.parametrize("name", MONITORS)
def test_the_old_name_of_a_monitor_command_works_and_says_the_new_one(name: str, capsys) -> None:
    part = {"model": ["show"], "adm": ["learn"]}.get(name, [])
    for words in ([name, *part], ["monitor", name, *part]):
        main([*words, "--help-me"])
        said = capsys.readouterr().err.splitlines()
        assert said[-1].endswith(f"(see fame monitor {' '.join([name, *part])} --help)")
        assert said[:-1] == ([f"fame: note: fame {name} is now fame monitor {name}"] if words[0] == name else [])
    main([name, *part, "--json"])
    assert "is now" not in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("ru", "run"),
        ("run --mid", "--middleware"),
        ("run --middleware ", "local dds zenoh ros"),
        ("run --middleware dds --sp", "--speed"),
        ("run --log ", ""),
        ("team stat", "status"),
        ("monitor adm l", "learn"),
        ("log ", "record convert merge collect judge"),
        ("completion f", "fish"),
    ],
)
def test_bash_completes_commands_options_and_choices(typed: str, offered: str, capsys) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    words = ["fame", *typed.split(" ")]
    ends = f'COMP_WORDS=("$@"); COMP_CWORD={len(words) - 1}; _fame; echo "${{COMPREPLY[*]}}"'
    done = subprocess.run(["bash", "-c", f"{script}{ends}", "_", *words], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == (f"{offered}\n", "")


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_a_script_with_the_same_words(shell: str, capsys) -> None:
    assert main(["completion", shell]) == 0
    assert "local dds zenoh ros" in capsys.readouterr().out


@pytest.mark.parametrize("command", NAMES)
def test_each_command_explains_itself_with_examples(command: str, capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: fame {command} ")
    assert f"\nexamples:\n  fame {command}" in out


def test_each_example_of_fame_check_is_a_command_line(capsys) -> None:
    with pytest.raises(SystemExit):
        main(["check", "--help"])
    examples = capsys.readouterr().out.partition("\nexamples:\n")[2].splitlines()
    given = [parser("check").parse_args(line.split()[1:]) for line in examples]
    (compared,) = (one for one in given if one.against_graph)
    assert ([str(path) for path in compared.models], compared.wait) == (["examples/warehouse.yaml"], 5.0)


@pytest.mark.parametrize("command", NAMES)
def test_each_command_with_a_middleware_says_for_which_ros_arguments_count(command: str, capsys) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    out = capsys.readouterr().out
    assert ("[--middleware" in out) == ("--ros-args" in out)


def test_the_version_is_one_line(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"fame {__version__}\n"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("rn", "got 'rn'; did you mean 'run'? (see fame --help)"),
        ("topic ech", "got 'ech'; did you mean 'echo'? (see fame topic --help)"),
        ("run x.yaml --middleware ddss", "got 'ddss'; did you mean 'dds'? (see fame run --help)"),
        ("run --picure x.png x.yaml", "unknown option '--picure'; did you mean '--picture'? (see fame run --help)"),
        ("run x.yaml y.yaml", "unexpected argument 'y.yaml' (see fame run --help)"),
    ],
)
def test_a_mistyped_word_is_told_with_the_closest_one(given: str, said: str, capsys) -> None:
    assert main(given.split()) == 2
    err = capsys.readouterr().err
    assert err.endswith(f"{said}\n")
    assert err.count("\n") == 1


def test_an_option_that_is_like_no_other_is_told_with_all(capsys) -> None:
    assert main(["run", "--variable", "x=1", "x.yaml"]) == 2
    assert "unknown option '--variable'; known are: -h, --help, " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("draw run.mcap -o x.svg", "run.mcap: expected a model, got a recording: fame draw MODEL.bpmn --log RUN.mcap "),
        ("view run.mcap --control", "run.mcap: --control is for a running team: fame view without a file"),
        ("campaign --runs ten", "expected a whole number from 1 on, got 'ten'"),
        ("world models/convoy.bpmn", "models/convoy.bpmn: expected a world, or a scenario that has one (.yaml), "),
        ("templates -o README.md", "README.md: expected a folder, got a file"),
    ],
)
def test_another_kind_of_file_is_told_as_that(given: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(ROOT)
    assert main(given.split()) == 2
    assert said in capsys.readouterr().err


def test_without_a_command_it_explains_itself(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage: fame ")


class Terminal(StringIO):
    """A stream that people see."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_that_has_colours_gets_them(monkeypatch: pytest.MonkeyPatch) -> None:
    line = "error: x.bpmn:3: warning: Task_1: note: completed: no"
    for name, value in {"TERM": "xterm", "NO_COLOR": ""}.items():
        monkeypatch.setenv(name, value)
    assert coloured(f"x.bpmn:3: warning: error: y\n{line}", Terminal()) == (
        f"x.bpmn:3: \x1b[1;33mwarning\x1b[0m: error: y\n\x1b[1;31merror\x1b[0m{line.removeprefix('error')}"
    )
    assert coloured(line, StringIO()) == line
    monkeypatch.setenv("NO_COLOR", "1")
    assert coloured(line, Terminal()) == line
    monkeypatch.setenv("NO_COLOR", "")
    monkeypatch.setenv("TERM", "dumb")
    assert coloured(line, Terminal()) == line


def test_commands_colour_what_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, Terminal())
    assert main(["run", "none.yaml"]) == 2
    assert main(["check", "--guidelines", str(ROOT / "models" / "convoy.bpmn")]) == 0
    assert sys.stderr.getvalue().startswith("fame: \x1b[1;31merror\x1b[0m: none.yaml: ")
    assert ": \x1b[1;36mnote\x1b[0m: " in sys.stdout.getvalue()


@pytest.mark.parametrize(
    ("options", "package"), [("", "pymunk"), ("--picture x.png", "matplotlib"), ("--animate x.gif", "PIL")]
)
def test_a_missing_extra_is_told_before_anything_is_written(
    options: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["run", str(ROOT / "examples" / "convoy.yaml"), "--log", "x.jsonl", *options.split()]) == 2
    assert capsys.readouterr().err.endswith(": pip install 'fame-robots[sim]'\n")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_ffmpeg_is_told_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["run", str(ROOT / "examples" / "convoy.yaml"), "--log", "x.jsonl", "--animate", "x.mp4"]) == 2
    assert "needs ffmpeg" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.processes
def test_a_reader_that_leaves_early_ends_the_command_in_silence() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = fame("check", "models/ground_vehicles.bpmn", stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.processes
def test_a_name_that_the_terminal_cannot_show_is_escaped(tmp_path: Path) -> None:
    text = (ROOT / "models" / "ground_vehicles.bpmn").read_text().replace('name="REX"', 'name="Mäher"')
    (tmp_path / "mission.bpmn").write_text(text, encoding="utf-8")
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = fame("split", str(tmp_path / "mission.bpmn"), "-o", str(tmp_path), stdout=subprocess.PIPE, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0].endswith("M\\xe4her.bpmn")


class Broken(Exception):
    """A bug."""


@pytest.fixture
def bug(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command with a bug in it."""

    def run(arguments: object) -> int:
        raise Broken("what was never thought of")

    monkeypatch.setattr(run_command, "run", run)


@pytest.mark.usefixtures("bug")
def test_a_bug_is_one_line_that_says_so(capsys) -> None:
    assert main(["run", "x.yaml"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("fame: error: Broken: what was never thought of (this is a bug")


@pytest.mark.usefixtures("bug")
def test_a_bug_shows_where_it_is_if_asked(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("FAME_DEBUG", "1")
    assert main(["run", "x.yaml"]) == 1
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert __file__ in err


@pytest.mark.usefixtures("bug")
def test_a_bug_with_json_is_one_object_too(capsys) -> None:
    assert main(["run", "x.yaml", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["status"], told["error"]["class"]) == ("error", "Broken")


def test_a_command_without_memory_is_no_bug(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def run(arguments: object) -> int:
        raise MemoryError

    monkeypatch.setattr(run_command, "run", run)
    assert main(["run", "x.yaml"]) == 1
    assert capsys.readouterr().err == "fame: error: no memory is left\n"


def test_an_interruption_of_which_a_library_made_another_error_is_one(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def import_numpy(arguments: object) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("could not import module datetime") from None
        return 0

    monkeypatch.setattr(run_command, "run", import_numpy)
    assert main(["run", "x.yaml"]) == 130
    assert capsys.readouterr().err == "fame: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interruption_of_the_first_import_is_one(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    class Interrupted:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "fame.cli.arguments":
                raise KeyboardInterrupt

    for name in [name for name in sys.modules if name == "fame.cli" or name.startswith("fame.cli.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("fame.cli")
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    assert begin() == 130
    assert capsys.readouterr().err == "fame: interrupted\n"


@pytest.mark.long
def test_an_interruption_of_tests_has_its_code_and_an_error_of_collection_has_not(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text("import signal\ndef test_it(): signal.raise_signal(signal.SIGINT)\n")
    code, said = fame_test(str(tmp_path))
    assert (code, "test_it.py:2: KeyboardInterrupt" in said) == (130, True), said
    (tmp_path / "test_it.py").write_text("import no_such_module\n")
    assert fame_test(str(tmp_path))[0] == 1


@pytest.mark.long
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_a_closed_stream_is_no_fault_of_the_command(closed: str) -> None:
    words = f"{sys.executable} -m fame check models/ground_vehicles.bpmn {closed}"
    done = subprocess.run(["sh", "-c", words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "bug" not in done.stdout + done.stderr


@pytest.mark.long_but("sim2d")
@pytest.mark.parametrize("package", ["robots", "sim2d"])
def test_a_folder_that_hides_a_package_of_fame_is_named(package: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "models" / "ground_vehicles.bpmn", tmp_path)
    text = (ROOT / "examples" / "ground_vehicles.yaml").read_text().replace("../models/", "")
    (tmp_path / "own.yaml").write_text(text)
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").touch()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    command = [sys.executable, "-m", "fame", "run", "own.yaml", "--quiet"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"the folder {tmp_path / package} hides FAME's package {package!r}: rename it" in done.stderr


def test_the_help_of_a_command_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    _, *parts = capsys.readouterr().out.partition("\nexamples:")[0].split("\n\n")  # after the usage
    assert max(len(line) for part in parts for line in part.splitlines()) <= 60


def test_an_interruption_is_told_and_has_its_code(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def run(arguments: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(run_command, "run", run)
    assert main(["run", "x.yaml"]) == 130
    assert capsys.readouterr().err == "fame: interrupted\n"
    assert main(["run", "x.yaml", "--json"]) == 130
    assert json.loads(capsys.readouterr().out)["status"] == "interrupted"


def test_a_narrow_terminal_gets_the_columns_that_matter() -> None:
    heads, rows = ("process", "robot", "state"), [(4711, "Tractor_1", "running")]
    assert table_within(80, heads, rows, ["process", "state"]) == table(heads, rows)
    assert table_within(20, heads, rows, ["process", "state"]) == "robot      state\nTractor_1  running"
    assert table_within(9, heads, rows, ["process", "state"]) == "robot\nTractor_1"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("view run.mcap --properties x.yaml", "fame log judge"),
        ("view run.mcap --as ann:nurse", "--as is for a running team"),
        ("view --as ann:nurse", "--as needs --control"),
        ("view --allow deploy", "--allow deploy needs --control"),
        ("run examples/shuttle.yaml --as ann:nurse", "--as needs --view"),
        ("run examples/shuttle.yaml --paused", "--paused needs --view"),
    ],
)
def test_options_that_would_do_nothing_are_refused(words: str, said: str, capsys, monkeypatch) -> None:
    monkeypatch.chdir(Path(__file__).parent.parent)
    assert main(words.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_a_selection_without_a_test_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "test_it.py").write_text("def test_a() -> None: ...")
    for words, said in (
        (["test_it.py", "-k", "nothing"], "no test matches -k 'nothing'"),
        ([], "there is no test (def test_... in test_*.py)"),
    ):
        assert fame_test(*words, folder=tmp_path)[0] == 2
        assert capsys.readouterr().err == f"fame: error: no test has run: {said}\n"
        (tmp_path / "test_it.py").unlink(missing_ok=True)


def test_a_printed_command_can_be_pasted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = str(tmp_path / "the key")
    assert main(["keys", "new", name]) == 0
    printed = capsys.readouterr().out
    assert f"fame deploy MODEL.bpmn --key '{name}.key'" in printed
    assert f"fame engine ROBOT --trust '{name}.pub'" in printed
    assert main(["keys", "robot", str(tmp_path / "REX"), "--key", f"{name}.key"]) == 0


def test_properties_are_not_judged_in_a_file_of_another_kind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.bpmn").write_bytes((ROOT / "models" / "agriculture.bpmn").read_bytes())
    (tmp_path / "m.properties.yaml").write_text("properties: {a: Tractor fails}")
    (tmp_path / "run.html").touch()
    assert main(["log", "judge", str(tmp_path / "m.properties.yaml"), str(tmp_path / "run.html")]) == 2
    ends = ".mcap, .jsonl, .csv, .xes, .xes.gz, .ocel.json, got '.html'; or a bag of ROS 2\n"
    assert capsys.readouterr().err.endswith(ends)
