"""A package of an extra that is missing is told in one sentence, with the command that installs it."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

from fame.imports import BASE, EXTRAS
from fame.rooms import install

ROOT = Path(__file__).parent.parent
OURS = ("fame", "robots", "sim2d")
BRINGS = {"joblib": ("sklearn", "skops"), "scipy": ("sklearn", "skops"), "sklearn": ("skops",)}
"""What cannot be imported without a package, either."""
_ROS = {"rclpy", "rcl_interfaces"}
"""What comes with ROS 2: `fame.middleware.ros` says so."""


def test_every_import_outside_of_the_base_installation_has_its_sentence() -> None:
    known = {*sys.stdlib_module_names, *OURS, *BASE, *EXTRAS, *_ROS, "zstandard", "lz4"}  # those of mcap and rosbags
    lines = re.compile(r"^ *(?:import (\w+)|from (\w+)[\w.]* import )", re.MULTILINE)
    untold = [
        f"{path}: {name}"
        for room in OURS for path in (ROOT / room).rglob("*.py")
        for first, second in lines.findall(path.read_text("utf-8")) if (name := first or second) not in known
    ]  # fmt: skip
    assert untold == []


def test_the_extras_that_are_told_exist_and_have_the_package() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    other_name = {"PIL": "pillow", "foxglove": "foxglove-sdk", "prometheus_client": "prometheus-client",
                  "quickjs": "quickjs-ng", "resvg_py": "resvg-py", "sklearn": "scikit-learn",
                  "zenoh": "eclipse-zenoh"}  # fmt: skip
    lacking = [
        package for package, (_, extra) in EXTRAS.items()
        if not any(each.startswith(other_name.get(package, package)) for each in extras[extra])
    ]  # fmt: skip
    assert lacking == []


ON_NETWORK = (
    "engine REX", "deploy MODEL", "splitter", "status", "complete REX task", "pause", "topic list", "param list /node",
    "world CONVOY", "monitor record record.yaml -o x.csv", "monitor process low_pass.yaml",
    "monitor adm collect --topic /t --label 1 -o x.csv", "log record -o x.mcap", "view --no-open",
    "run CONVOY",
)  # fmt: skip
NEEDS: dict[str, tuple[str, ...]] = {
    "pymunk": ("run CONVOY", "check CONVOY", "demo", "campaign CONVOY --runs 1 --jobs 1",
               "world CONVOY --middleware zenoh"),
    "matplotlib": ("run CONVOY --picture x.png", "run CONVOY --animate x.gif", "demo", "campaign CONVOY --runs 1",
                   "draw RUN.mcap -o x.gif"),
    "PIL": ("run CONVOY --animate x.gif", "run CONVOY --picture x.png", "demo", "draw RUN.mcap -o x.gif"),
    "resvg_py": ("run CONVOY --animate x.gif", "demo", "draw RUN.mcap -o x.gif"),
    "scipy": ("campaign CONVOY --runs 1", "run REASSEMBLY", "run SABOTAGE", "monitor adm learn learn.yaml",
              "monitor train train.yaml"),
    "sklearn": ("run SABOTAGE", "run REASSEMBLY", "monitor adm learn learn.yaml", "monitor train train.yaml",
                "monitor judge SKOPS runs.csv", "monitor model show SKOPS"),
    "skops": ("run REASSEMBLY", "check REASSEMBLY", "run SABOTAGE", "monitor judge SKOPS runs.csv",
              "monitor model show SKOPS", "monitor process skops.yaml --middleware zenoh",
              "monitor adm learn learn.yaml"),
    "joblib": ("campaign CONVOY --runs 1", "monitor adm learn learn.yaml", "run SABOTAGE"),
    "onnx": ("monitor train train.yaml --onnx x.onnx",),
    "onnxruntime": ("monitor process onnx.yaml --middleware zenoh", "monitor train train.yaml --onnx x.onnx"),
    "pandas": ("campaign CONVOY --runs 1 --jobs 1 --parquet", "monitor judge SKOPS runs.parquet"),
    "pyarrow": ("campaign CONVOY --runs 1 --jobs 1 --parquet", "monitor judge SKOPS runs.parquet"),
    "distributed": ("campaign CONVOY --runs 1 --backend dask --address tcp://127.0.0.1:1",),
    "ray": ("campaign CONVOY --runs 1 --backend ray --address 127.0.0.1:1",),
    "pytest": ("test .",),
    "starlette": ("view RUN.mcap", "view CONVOY"),
    "uvicorn": ("view RUN.mcap", "view CONVOY"),
    "websockets": ("view RUN.mcap", "view CONVOY"),
    "quickjs": ("run JS.bpmn", "check JS.bpmn"),
    "cyclonedds": tuple(f"{command} --middleware dds" for command in ON_NETWORK),
    "zenoh": (*(f"{command} --middleware zenoh" for command in ON_NETWORK), "router"),
    "xxhash": ("status --middleware zenoh",),
    "cryptography": ("keys new team", "deploy MODEL --key team.key", "engine REX --trust team.pub"),
    "foxglove": ("view --foxglove 0",),
    "prometheus_client": ("engine REX --metrics 9", ),
}  # fmt: skip

FILES = {
    "SKOPS": ROOT / "models" / "reassembly.skops",
    "MODEL": ROOT / "models" / "convoy.bpmn",
    "RUN.mcap": ROOT / "tests" / "recordings" / "failed.mcap",
    "JS.bpmn": ROOT / "tests" / "models" / "javascript" / "Explore.bpmn",
    **{name.upper(): ROOT / "examples" / f"{name}.yaml" for name in ("convoy", "reassembly", "sabotage")},
}
IN = "Inputs: {x: {Topic: /t, MessageType: std_msgs/msg/Float64, Field: data}}\n"
OWN = {
    "record.yaml": IN,
    "low_pass.yaml": IN + "Processor: {Class: LowPass, Parameters: {cutoff: 1}}\n",
    "skops.yaml": IN + f"Processor: {{Class: Autoencoder, Parameters: {{model: {FILES['SKOPS']}}}}}\n",
    "onnx.yaml": IN + "Processor: {Class: Estimator, Parameters: {model: train.yaml.onnx}}\n",
    "train.yaml.onnx": "",
    "train.yaml": IN
    + "Training: {Files: [runs.csv], Model: x.skops, Detector: autoencoder, window: 5, samples: 50, epochs: 1}\n",
    "learn.yaml": """\
Files: {unsupervised_train: {name: good.csv, input_col: [0, 1, 2], output_col: [3]}}
Classifiers: [{name: svm, class: OneClassSVM, threshold: 0.1}]
Split: {folds: 0}
""",
    "good.csv": "".join(f"{row % 7},{row % 5},{row % 3},1\n" for row in range(60)),
    "runs.csv": "stamp,run,x\n" + "".join(f"{row / 10},{row // 30},{row % 7}\n" for row in range(90)),
}


def our_modules() -> dict[str, ModuleType]:
    return {name: module for name, module in sys.modules.items() if name.partition(".")[0] in OURS}


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Hide a package, as an environment without it has it: nothing of ours was imported with it."""
    before = our_modules()

    def hide(package: str) -> None:
        for name in before:
            del sys.modules[name]
        for name in (package, *BRINGS.get(package, ())):
            monkeypatch.setitem(sys.modules, name, None)

    yield hide
    for name in our_modules():
        del sys.modules[name]
    sys.modules.update(before)


@pytest.mark.long_but(
    "*-run CONVOY", "*-check JS*", "skops-monitor judge*", "*-view RUN*", "*-keys*", "cyclonedds-engine*"
)
@pytest.mark.parametrize(("package", "command"), [(name, command) for name, all in NEEDS.items() for command in all])
def test_a_command_says_which_package_it_lacks(
    package: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd, without: Callable[[str], None]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in OWN.items():
        Path(name).write_text(text)
    without(package)
    from fame.cli import main

    words = [str(FILES.get(word, word)) for word in command.split()]
    code = main(words)
    out = capfd.readouterr()
    said = out.out + out.err
    assert any(install(EXTRAS[lacking][1]) in said for lacking in (package, *BRINGS.get(package, ())))
    assert [word for word in ("bug", "corrupt", "Traceback") if word in said] == []
    assert code in ((0,) if words[0] == "check" else (1, 2))
