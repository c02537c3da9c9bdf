"""What `fame check` says of scripts: requests that nobody awaits, misspelt methods, names of earlier scripts."""

from html import escape
from pathlib import Path

import pytest
from check_drawing import alone, choice, ends, flow, flows, row, script, throw, told

from fame.check import check

TEXT = "std_msgs/msg/String"
WARNINGS = {
    "a message that nobody awaits": (
        'm = receive("/found")\nlog(m.data)',
        "t: receive(...) has no result unless it is awaited: m = await receive(...)",
    ),
    "a message that nobody in the script looks at": (
        'm = receive("/found")',
        "t: receive(...) has no result unless it is awaited: m = await receive(...)",
    ),
    "a field of a response that nobody awaits": (
        'ok = robot.call("grip", "std_srvs/srv/Trigger").success',
        "t: robot.call(...) has no result unless it is awaited: (await robot.call(...))",
    ),
    "a condition that nobody awaits": (
        "if until(lambda: True): pass",
        "t: until(...) has no result unless it is awaited: (await until(...))",
    ),
    "a misspelt method of the robot": (
        f'robot.publsh("a", "{TEXT}")',
        "t: robot has no 'publsh'; did you mean robot.publish?",
    ),
    "a module that is not found": (
        "import own_tools",
        "t: imports own_tools, which Python does not find here: install it, or name its folder in PYTHONPATH",
    ),
    "a level that the log does not have": ('log.warn("x")', "t: log has no 'warn'; did you mean log.warning?"),
}


@pytest.mark.parametrize(("text", "expected"), WARNINGS.values(), ids=WARNINGS.keys())
def test_it_is_a_warning(text: str, expected: str) -> None:
    assert told(alone(row(script(text)))) == [expected]


def test_a_method_that_is_like_none_is_told_with_those_that_there_are() -> None:
    (found,) = told(alone(row(script("robot.fly()"))))
    assert found.startswith("t: robot has no 'fly'; it has act, call, ")


DOUBTFUL_CALLS = {
    "import time\nx = time.time()": "time.time() is the clock of the computer, not the time of the mission: "
    "use robot.now",
    "from datetime import datetime\nx = datetime.now()": "datetime.datetime.now() is the clock of the computer, not "
    "the time of the mission: use robot.date",
    "import uuid as u\nx = u.uuid4().hex": "uuid.uuid4() differs in each run, also with the same seed: "
    "use robot.random",
    "from secrets import choice\nx = choice([1, 2])": "secrets.choice() differs in each run, also with the same seed: "
    "use robot.random",
    "from time import *\na = 1\nb = time()": "time.time() is the clock of the computer, not the time of the mission: "
    "use robot.now",
    "import time\nnow = time.time\nx = now()": "time.time() is the clock of the computer, not the time of the mission: "
    "use robot.now",
    "import numpy as np\nx = float(np.random.default_rng().normal())": "numpy.random.default_rng() without a seed "
    "differs in each run: use robot.random, or give it a seed",
    "import random\nrandom.seed(a=None)": "random.seed() without a seed differs in each run: use robot.random, or give "
    "it a seed",
    "import numpy\nx = numpy.random.Generator(numpy.random.PCG64(None))": "numpy.random.PCG64() without a seed differs "
    "in each run: use robot.random, or give it a seed",
    "from time import perf_counter_ns\nx = perf_counter_ns()": "time.perf_counter_ns() is the clock of the computer, "
    "not the time of the mission: use robot.now",
    "from time import sleep\nsleep(5)": "time.sleep() blocks the whole robot: use await sleep(...)",
}


@pytest.mark.parametrize(("text", "expected"), DOUBTFUL_CALLS.items())
def test_what_a_seed_does_not_repeat_or_blocks_is_a_warning(text: str, expected: str) -> None:
    assert told(alone(row(script(text)))) == [f"t: {expected}"]


def test_a_sleep_in_a_comment_blocks_nothing() -> None:
    assert told(alone(row(script("# time.sleep(1)\nx = 'time.sleep(1)'")))) == []


IMPORTS = "import own_tools.parts as parts\nfrom tools_of_others import cut"


def test_a_module_that_is_not_found_is_a_warning_once() -> None:
    assert told(alone(row(script(IMPORTS), script("import own_tools", "u")))) == [
        "t: imports own_tools, which Python does not find here: install it, or name its folder in PYTHONPATH",
        "t: imports tools_of_others, which Python does not find here: install it, or name its folder in PYTHONPATH",
    ]


def test_the_folder_of_a_module_beside_the_model_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mission.bpmn").write_text(alone(row(script("import own_tools"))))
    (tmp_path / "own_tools.py").touch()
    (found,) = check(tmp_path / "mission.bpmn")
    assert found.text == f"imports own_tools, which Python does not find here: set PYTHONPATH={tmp_path}"
    monkeypatch.syspath_prepend(tmp_path)
    assert check(tmp_path / "mission.bpmn") == []


FINE = {
    "a module that a script tries": "try:\n    import own_tools\nexcept ImportError:\n    own_tools = None",
    "modules that are there": "import os.path, numpy\nfrom json import dumps",
    "random numbers that a seed repeats": "import random\nimport numpy as np\n"
    "x = random.random() + robot.random.random()"
    "\ng = np.random.default_rng(robot.random.getrandbits(64))\ny = random.Random(3)",
    "a function of the same name as a clock": "def time(): return 3\nx = time()",
    "a message that is awaited": 'm = await receive("/found")\nlog(m.data)',
    "a request that is awaited later": 'r = receive("/found")\nm = await r',
    "requests in a list": 'rs = [receive("/found")]\nfor r in rs: await r',
    "a request that a function awaits": 'async def first(r): return await r\nr = receive("/found")\nawait first(r)',
    "a function of the same name": 'def receive(topic): return topic\nm = receive("/found")\nlog(m.data)',
    "all that the robot has": "log(robot.name, robot.namespace, robot.now)\nlog.warning(robot.publish)",
    "a parameter named like the robot": "def f(robot): return robot.fly()",
}


@pytest.mark.parametrize("text", FINE.values(), ids=FINE.keys())
def test_it_is_not_blamed(text: str) -> None:
    assert told(alone(row(script(text)))) == []


def test_expressions_may_name_the_robot_that_evaluates_them() -> None:
    def sending(payload: str) -> str:
        return alone(row(throw("a", type=TEXT, payload=payload)))

    assert told(sending("{data: '${robot.name}'}"), "warning", "error") == []
    assert not any("robot" in text for text in told(sending("=robot.namespace"), "warning", "note"))
    assert told(sending("I am ${robot.nam}")) == ["a: robot has no 'nam'; did you mean robot.name?"]


DEFINING = "import json\nfrom os import path as p\ndef double(x): return 2 * x\nclass Part: pass"


def test_what_a_script_imports_and_defines_is_there_for_later_ones() -> None:
    using = script("y = double(1), Part(), json.dumps(p.sep)", "t2")
    assert told(alone(row(script(DEFINING), using))) == []
    assert told(alone(row(script("from math import *"), script("y = tau", "t2")))) == []
    assert told(alone(row(script("def double(x):\n  import json\n  return x"), script("y = json", "t2")))) == [
        "t2: reads `json`, which nothing sets"
    ]
    assert told(alone(row(script(DEFINING), script("y = duoble(1)", "t2")))) == [
        "t2: reads `duoble`, which nothing sets; did you mean `double`?"
    ]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("var x = 1;", "`var x = 1;`"),
        ("this.environment.variables.x = 1;\nif (x) {\n  next();\n}", "`if (x) {`"),
        ("const f = () => 3;", "`const f = () => 3;`"),
    ],
)
def test_javascript_without_its_language_is_told_as_that(text: str, found: str) -> None:
    (said,) = told(alone(row(script(escape(text), format=""))), "error")
    assert said == f't: not valid Python: invalid syntax: {found}; for JavaScript, set scriptFormat="javascript"'
    assert told(alone(row(script("x = 1; x = x..y"))), "error") == [
        "t: not valid Python: invalid syntax: `x = 1; x = x..y`"
    ]


def test_javascript_that_python_would_take_is_told_by_its_names() -> None:
    assert told(alone(row(script("this.environment.variables.x = 1; next()", format="")))) == [
        "t: reads `this`, which nothing sets; for JavaScript, set the script format javascript"
    ]


def test_a_condition_in_javascript_is_told_as_that() -> None:
    text = (
        row(script("x = 1"))
        + choice("g", 'default="g-b"')
        + ends("a", "b")
        + flows("s g b")
        + flow("g", "a", "x === 1")
    )
    assert told(alone(text), "error") == [
        'g: not valid Python: invalid syntax: `x === 1`; for JavaScript, set language="javascript"'
    ]


@pytest.mark.parametrize("text", ["robot" + ".name" * 900, "receive" + "()" * 900, "v = " + "-" * 900 + "1"])
def test_scripts_that_are_nested_deeply_are_checked_as_far_as_can_be(text: str) -> None:
    assert all("not valid Python: RecursionError" in found for found in told(alone(row(script(text)))))
