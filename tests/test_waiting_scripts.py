"""Scripts that wait: what they can await, on the engine's clock, and how they are cancelled."""

from typing import Any

import pytest

from fame.bpmn.model import Expression
from fame.clock import SECOND, Kind, Scheduler
from fame.engine.data import Variables
from fame.errors import MessageError
from fame.middleware import messages
from fame.middleware.local import LocalMiddleware
from fame.scripting import BudgetExceeded, Robot, Runner, compile_script, error_line
from fame.scripting.interface import interface

STRING, FLOAT = "std_msgs/msg/String", "std_msgs/msg/Float64"


class Bench:
    """One robot's scripts over real topics and simulated time, with another node beside it."""

    def __init__(self) -> None:
        self.scheduler = Scheduler()
        self.middleware = LocalMiddleware(self.scheduler)
        self.node = self.middleware.node("engine", "REX")
        self.other = self.middleware.node("world")
        self.ends: list[tuple[int, str, float]] = []
        self.errors: dict[int, BaseException] = {}
        self.reports: list[str] = []
        self.stepped: list[int] = []
        self.signals: list[tuple[str, Any]] = []
        self.logged: list[str] = []
        self.runner = Runner(
            self.scheduler,
            self.node,
            self._ended,
            stepped=self.stepped.append,
            report=lambda key, text: self.reports.append(text),
            types=self._type,
        )
        self.variables: dict[str, Any] = {"__builtins__": self.names(1_000_000)}
        self.inside = False

    def names(self, budget: int) -> dict[str, Any]:
        return interface(
            robot=Robot("REX", "REX", self._publish, self.runner.inbox, lambda: self.scheduler.now / SECOND),
            signal=lambda name, payload=None: self.signals.append((name, payload)),
            log=lambda level, text: self.logged.append(text),
            budget=budget,
        )

    def start(self, text: str, key: int = 1) -> None:
        script = compile_script(Expression(text, line=1), file="m.bpmn")(self.variables)
        assert script is not None
        self.inside = True
        self.runner.start(key, script)
        self.inside = False

    def cancel(self, key: int = 1) -> bool:
        self.inside = True
        try:
            return self.runner.cancel(key)
        finally:
            self.inside = False

    def send(self, topic: str, type: str, value: Any, at: float = 0.0) -> None:
        publisher = self.other.publisher(topic, type)
        self.scheduler.at(round(at * SECOND), lambda: publisher.publish(messages.create(type, value)), Kind.MESSAGE)

    def _publish(self, topic: str, type: str, value: Any) -> None:
        self.node.publisher(topic, type).publish(messages.create(type, value))

    def _type(self, topic: str) -> str | None:
        return next((info.types[0] for info in self.middleware.graph() if info.name == topic), None)

    def _ended(self, key: int, error: BaseException | None) -> None:
        assert not self.inside, "an end is told from inside a call of the engine"
        self.ends.append((key, type(error).__name__ if error else "", self.scheduler.now / SECOND))
        if error is not None:
            self.errors[key] = error


@pytest.fixture
def bench() -> Bench:
    return Bench()


# ---- what can be awaited ---------------------------------------------------------------------------------------------


def test_sleep_waits_on_the_engines_clock(bench: Bench) -> None:
    bench.start("x = 1\nawait sleep(2.5)\nx = 2")
    assert (bench.variables["x"], bench.runner.waits(1)) == (1, "sleep(2.5)")
    bench.scheduler.run(until=2 * SECOND)
    assert bench.variables["x"] == 1
    bench.scheduler.run()
    assert (bench.variables["x"], bench.ends) == (2, [(1, "", 2.5)])


def test_a_script_that_need_not_wait_ends_as_a_later_stimulus(bench: Bench) -> None:
    bench.start("x = 1\nif x > 1: await sleep(1)")
    assert bench.ends == []
    bench.scheduler.run()
    assert bench.ends == [(1, "", 0.0)]


def test_each_step_is_told_so_that_conditions_can_be_tried(bench: Bench) -> None:
    bench.start("await sleep(1)\nawait sleep(1)")
    bench.scheduler.run()
    assert (bench.stepped, bench.ends) == ([1], [(1, "", 2.0)])


def test_receive_gives_the_next_message(bench: Bench) -> None:
    bench.send("/REX/range", FLOAT, 1.0, at=1)
    bench.send("/REX/range", FLOAT, 2.0, at=2)
    bench.start("a = (await receive('range')).data\nb = (await receive('~/range', timeout=5)).data")
    bench.scheduler.run()
    assert (bench.variables["a"], bench.variables["b"], bench.ends) == (1.0, 2.0, [(1, "", 2.0)])


def test_receive_hears_nothing_from_before_it_was_awaited(bench: Bench) -> None:
    bench.send("/x", FLOAT, 1.0, at=1)
    bench.send("/x", FLOAT, 2.0, at=3)
    bench.start("robot.latest('/x')\nawait sleep(2)\nold = robot.latest('/x').data\nnew = (await receive('/x')).data")
    bench.scheduler.run()
    assert (bench.variables["old"], bench.variables["new"]) == (1.0, 2.0)


def test_receive_gives_up_after_its_timeout(bench: Bench) -> None:
    bench.start(f"try:\n  await receive('/x', '{STRING}', timeout=1.5)\nexcept TimeoutError as e:\n  text = str(e)")
    bench.scheduler.run()
    assert (bench.variables["text"], bench.ends) == ("receive('/x'): nothing within 1.5 s", [(1, "", 1.5)])


def test_a_message_at_the_very_time_of_the_timeout_wins(bench: Bench) -> None:
    bench.start(f"a = (await receive('/x', '{FLOAT}', timeout=1)).data\nawait sleep(5)")
    bench.send("/x", FLOAT, 3.0, at=1)
    bench.scheduler.run()
    assert (bench.variables["a"], bench.ends) == (3.0, [(1, "", 6.0)])


def test_a_topic_whose_type_nobody_says_is_an_error_at_the_await(bench: Bench) -> None:
    bench.start("x = 1\nawait receive('odom')")
    bench.scheduler.run()
    error = bench.errors[1]
    assert isinstance(error, MessageError)
    assert "topic /REX/odom: unknown type" in str(error)
    assert error_line(error, "m.bpmn") == 2


def test_a_topic_has_one_type_for_all_scripts_of_a_robot(bench: Bench) -> None:
    bench.start("robot.latest('/x', 'std_msgs/String')\nrobot.latest('/x', 'std_msgs/msg/String')\nawait sleep(0)")
    bench.start("await receive('/x', 'std_msgs/msg/Bool')", key=2)
    bench.scheduler.run()
    assert bench.ends == [(1, "", 0.0), (2, "MessageError", 0.0)]


def test_until_goes_on_when_a_variable_has_changed(bench: Bench) -> None:
    bench.variables |= {"x": 0}
    bench.start("await until(lambda: x > 1)\nseen = x", key=1)
    bench.start("for i in range(3):\n  await sleep(1)\n  x = x + 1", key=2)
    bench.scheduler.run()
    assert (bench.variables["seen"], bench.ends) == (2, [(1, "", 2.0), (2, "", 3.0)])


def test_until_goes_on_when_a_message_has_changed_what_it_asks_for(bench: Bench) -> None:
    bench.send("/REX/range", FLOAT, 0.3, at=1)
    bench.start("await until(lambda: (m := robot.latest('range')) and m.data < 0.5)")
    bench.scheduler.run()
    assert bench.ends == [(1, "", 1.0)]


def test_until_goes_on_at_once_if_it_is_true_and_after_a_poll_if_it_becomes_so(bench: Bench) -> None:
    bench.variables["x"] = 1
    bench.start("got = await until(lambda: x)\nawait until(lambda: x > 1)")
    bench.scheduler.run()
    assert (bench.variables["got"], bench.ends) == (1, [])
    bench.variables["x"] = 2
    bench.runner.poll()
    bench.scheduler.run()
    assert bench.ends == [(1, "", 0.0)]


def test_until_gives_up_after_its_timeout_and_raises_what_its_condition_raises(bench: Bench) -> None:
    bench.start("await until(lambda: False, timeout=2)", key=1)
    bench.start("await until(lambda: 1 / 0)", key=2)
    bench.scheduler.run()
    assert bench.ends == [(2, "ZeroDivisionError", 0.0), (1, "TimeoutError", 2.0)]


def test_a_subscription_gives_all_messages_in_order(bench: Bench) -> None:
    for number in range(5):
        bench.send("/REX/odom", FLOAT, number, at=1 + number / 10)
    bench.start("got = []\nasync for m in robot.subscribe('odom'):\n  got.append(m.data)\n  await sleep(1)\n"
                "  if len(got) == 5: break")  # fmt: skip
    bench.scheduler.run()
    assert (bench.variables["got"], bench.ends) == ([0, 1, 2, 3, 4], [(1, "", 6.0)])


def test_the_queue_of_a_subscription_keeps_the_last_messages(bench: Bench) -> None:
    for number in range(5):
        bench.send("/x", FLOAT, number)
    bench.start("q = robot.subscribe('/x', queue=2)\nawait sleep(1)\ngot = []\n"
                "async for m in q:\n  got.append(m.data)\n  if len(got) == 2: break")  # fmt: skip
    bench.scheduler.run()
    assert bench.variables["got"] == [3, 4]


def test_two_scripts_may_wait_for_one_topic(bench: Bench) -> None:
    bench.send("/x", FLOAT, 7.0, at=1)
    bench.start("a = (await receive('/x')).data", key=1)
    bench.start("b = (await receive('/x')).data", key=2)
    bench.scheduler.run()
    assert (bench.variables["a"], bench.variables["b"], [end[0] for end in bench.ends]) == (7.0, 7.0, [1, 2])


def test_a_service_is_called(bench: Bench) -> None:
    bench.other.service("/REX/arm", "std_srvs/srv/SetBool", lambda request: {"success": request.data, "message": "ok"})
    bench.start(
        "r = await robot.call('arm', 'std_srvs/srv/SetBool', data=True)\nok, text = r.success, r.message", key=1
    )
    bench.start("await robot.call('nothing', 'std_srvs/srv/Empty')", key=2)
    bench.scheduler.run()
    assert (bench.variables["ok"], bench.variables["text"]) == (True, "ok")
    assert sorted(bench.ends) == [(1, "", 0.0), (2, "MessageError", 5.0)]  # it may have come late


def test_messages_of_the_robot_itself_are_delivered_by_its_node(bench: Bench) -> None:
    bench.start(f"got = (await receive('/done', '{STRING}')).data")
    bench.runner.inbox.deliver("/done", messages.create(STRING, "yes"))
    bench.scheduler.run()
    assert bench.variables["got"] == "yes"


def test_a_script_publishes_and_throws_signals(bench: Bench) -> None:
    heard: list[Any] = []
    bench.other.subscription("/REX/led", "std_msgs/msg/ColorRGBA", heard.append)
    bench.start("robot.publish('led', 'std_msgs/msg/ColorRGBA', r=1.0)\n"
                "robot.publish('led', 'std_msgs/msg/ColorRGBA', {'g': 0.5})\n"
                "signal('done', True)\nwho = robot.name, robot.namespace\nawait sleep(0)")  # fmt: skip
    bench.scheduler.run()
    assert [(m.r, m.g) for m in heard] == [(1.0, 0.0), (0.0, 0.5)]
    assert (bench.signals, bench.variables["who"]) == ([("done", True)], ("REX", "REX"))


@pytest.mark.parametrize("text", ["import asyncio\nawait asyncio.sleep(0)", "await 5", "await robot.latest"])
def test_anything_else_that_is_awaited_is_an_error_by_name(bench: Bench, text: str) -> None:
    bench.start(text)
    bench.scheduler.run()
    assert bench.ends == [(1, "TypeError", 0.0)]


def test_a_foreign_await_says_what_can_be_awaited(bench: Bench) -> None:
    bench.start(
        "import types\n@types.coroutine\ndef f(): yield 5\ntry:\n  await f()\nexcept TypeError as e: text = str(e)"
    )
    bench.scheduler.run()
    assert bench.variables["text"].startswith("cannot await int: only sleep, receive, until")


def test_helper_functions_may_wait_too(bench: Bench) -> None:
    bench.start("async def twice(n):\n  await sleep(n)\n  await sleep(n)\n  return n\nx = await twice(2)")
    bench.scheduler.run()
    assert (bench.variables["x"], bench.ends) == (2, [(1, "", 4.0)])


def test_a_script_in_an_inner_scope_writes_where_its_names_are_after_each_step(bench: Bench) -> None:
    outer = bench.variables
    outer["x"] = 0
    inner = bench.variables = Variables(outer, {"item": 5})
    bench.start("def more():\n  global x, y\n  x += item\n  y = x\nmore()\nawait sleep(1)\nmore()")
    assert (outer["x"], "y" in outer) == (5, False)
    bench.scheduler.run()
    assert (outer["x"], inner["y"], bench.ends) == (10, 10, [(1, "", 1.0)])


def test_waiting_without_letting_time_go_on_is_a_livelock(bench: Bench) -> None:
    bench.start("while True: await sleep(0)")
    bench.scheduler.run()
    assert "times at one moment: sleep(0)" in str(bench.errors[1])


def test_the_budget_is_that_of_a_step_not_of_a_script(bench: Bench) -> None:
    bench.variables["__builtins__"] = bench.names(1000)
    bench.start("for i in range(5):\n  for j in range(500): pass\n  await sleep(1)\nwhile True: pass")
    bench.scheduler.run()
    assert bench.ends == [(1, "BudgetExceeded", 5.0)]


# ---- cancellation ----------------------------------------------------------------------------------------------------


def test_a_cancelled_script_is_out_at_once(bench: Bench) -> None:
    bench.start("try:\n  await sleep(10)\nfinally:\n  x = 'stopped'")
    assert bench.cancel() is True
    bench.scheduler.run()
    assert (bench.variables["x"], bench.ends, bench.scheduler.now, bench.runner.waits(1)) == ("stopped", [], 0, "")


@pytest.mark.parametrize("await_", ["receive('/x', 'std_msgs/msg/Bool', timeout=9)", "until(lambda: go, timeout=9)",
                                   "robot.subscribe('/x', 'std_msgs/msg/Bool').__anext__()", "sleep(9)",
                                   "robot.call('/s', 'std_srvs/srv/Empty')"])  # fmt: skip
def test_nothing_wakes_a_cancelled_script(bench: Bench, await_: str) -> None:
    bench.other.service("/s", "std_srvs/srv/Empty", lambda request: None)
    bench.variables["go"] = False
    bench.start(f"await {await_}\nx = 1")
    assert bench.cancel() is True
    bench.variables["go"] = True
    bench.runner.poll()
    bench.send("/x", "std_msgs/msg/Bool", True, at=1)
    bench.scheduler.run()
    assert ("x" in bench.variables, bench.ends, bench.reports) == (False, [], [])


def test_except_exception_does_not_swallow_a_cancellation(bench: Bench) -> None:
    bench.start("while True:\n  try:\n    await sleep(1)\n  except Exception: pass")
    assert bench.cancel() is True


def test_a_script_that_waits_in_its_finally_is_leaving(bench: Bench) -> None:
    bench.start("try:\n  await sleep(10)\nfinally:\n  await sleep(0.5)\n  x = 'stopped'")
    bench.scheduler.run(until=SECOND)
    assert bench.cancel() is False
    assert bench.cancel() is False
    bench.scheduler.run()
    assert (bench.variables["x"], bench.ends, bench.reports) == ("stopped", [(1, "", 1.5)], [])


def test_a_script_that_leaves_too_slowly_is_closed_after_the_grace(bench: Bench) -> None:
    bench.start("try:\n  await sleep(10)\nfinally:\n  await sleep(50)\n  x = 1")
    assert bench.cancel() is False
    bench.scheduler.run()
    assert ("x" in bench.variables, bench.ends) == (False, [(1, "", 2.0)])
    assert bench.reports == ["cancelled, but still running after 2 s: closed at sleep(50)"]


STUBBORN = {
    "swallows": "try:\n  await sleep(9)\nexcept BaseException: pass\nawait sleep(9)",
    "loops": "while True:\n  try:\n    await sleep(9)\n  except BaseException: continue",
    "loops bare": "while True:\n  try:\n    await sleep(9)\n  except: pass",
    "loops in finally": "while True:\n  try:\n    await sleep(9)\n  finally: continue",
    "loops without time": "while True:\n  try:\n    await sleep(0.1)\n  except: pass",
    "many handlers": "\n".join(["try: await sleep(9)\nexcept BaseException: pass"] * 20),
    "recursion": "async def f():\n  try: await sleep(9)\n  except BaseException: await f()\nawait f()",
    "for": "async for m in robot.subscribe('/x', 'std_msgs/msg/Bool'): pass",
    "for stubborn": "while True:\n  try:\n    async for m in robot.subscribe('/x', 'std_msgs/Bool'): 0\n  except: 0",
    "exits": "try:\n  await sleep(9)\nfinally:\n  raise SystemExit(3)",
    "interrupts": "try:\n  await sleep(9)\nfinally:\n  raise KeyboardInterrupt",
    "generator exit": "try:\n  await sleep(9)\nexcept BaseException:\n  raise GeneratorExit",
    "runs on": "try:\n  await sleep(9)\nfinally:\n  while True: pass",
}


@pytest.mark.parametrize("text", STUBBORN.values(), ids=STUBBORN)
def test_no_script_survives_its_cancellation(bench: Bench, text: str) -> None:
    bench.variables["__builtins__"] = bench.names(1000)
    bench.start(text)
    out = bench.cancel()
    bench.scheduler.run(until=60 * SECOND)
    assert bench.ends == ([] if out else [(1, "", 2.0)])
    assert bench.runner.waits(1) == ""


def test_errors_while_leaving_are_reported_not_thrown(bench: Bench) -> None:
    bench.start("try:\n  await sleep(9)\nfinally:\n  1 / 0", key=1)
    bench.start("try:\n  await sleep(9)\nfinally:\n  await sleep(1)\n  1 / 0", key=2)
    assert (bench.cancel(1), bench.cancel(2)) == (True, False)
    bench.scheduler.run()
    assert bench.ends == [(2, "", 1.0)]
    assert bench.reports == ["while it was cancelled: ZeroDivisionError: division by zero"] * 2


@pytest.mark.parametrize("raised", ["SystemExit(1)", "GeneratorExit()", "BaseException()", "KeyboardInterrupt()"])
def test_whatever_a_script_raises_ends_that_script_alone(bench: Bench, raised: str) -> None:
    bench.start(f"await sleep(1)\nraise {raised}", key=1)
    bench.start("await sleep(2)", key=2)
    bench.scheduler.run()
    assert bench.ends == [(1, raised.split("(")[0], 1.0), (2, "", 2.0)]


def test_the_interrupt_of_a_person_is_not_taken_for_an_error_of_the_script(bench: Bench) -> None:
    bench.start("import signal\nawait sleep(1)\nsignal.raise_signal(signal.SIGINT)\npass")
    with pytest.raises(KeyboardInterrupt):
        bench.scheduler.run()
    bench.runner.close()


def test_a_script_that_ended_in_its_first_step_can_still_be_cancelled(bench: Bench) -> None:
    bench.start("if False: await sleep(1)")
    assert bench.cancel() is True
    bench.scheduler.run()
    assert bench.ends == []


def test_a_message_on_its_way_to_a_script_is_lost_with_its_cancellation(bench: Bench) -> None:
    bench.start(f"x = await receive('/x', '{FLOAT}')")
    bench.runner.inbox.deliver("/x", messages.create(FLOAT, 1.0))
    assert bench.cancel() is True
    bench.scheduler.run()
    assert ("x" in bench.variables, bench.ends) == (False, [])


def test_a_script_that_cancels_itself_is_out_at_its_next_await(bench: Bench) -> None:
    bench.variables["stop"] = bench.cancel
    bench.start("try:\n  out = stop()\n  await sleep(1)\n  x = 1\nfinally:\n  y = 1")
    bench.scheduler.run()
    assert (bench.variables["out"], "x" in bench.variables, bench.variables["y"]) == (False, False, 1)
    assert bench.ends == [(1, "", 0.0)]


def test_closing_the_runner_stops_all_scripts_and_hears_nothing_more(bench: Bench) -> None:
    bench.start(f"try:\n  await receive('/x', '{FLOAT}')\nfinally:\n  a = 1", key=1)
    bench.start("while True:\n  try:\n    await sleep(1)\n  except: pass", key=2)
    bench.runner.close()
    bench.scheduler.run()
    assert (bench.variables["a"], bench.ends) == (1, [])
    assert [info.name for info in bench.middleware.graph()] == []


def test_a_script_that_closes_its_runner_is_out_at_its_next_await(bench: Bench) -> None:
    bench.variables["shut"] = bench.runner.close
    bench.start("try:\n  shut()\n  await sleep(1)\n  x = 1\nfinally:\n  y = 1")
    bench.scheduler.run()
    assert ("x" in bench.variables, bench.variables["y"]) == (False, 1)


def test_an_endless_step_after_an_await_is_an_error_of_that_script(bench: Bench) -> None:
    bench.variables["__builtins__"] = bench.names(1000)
    bench.start("await sleep(1)\n\nwhile True:\n  try:\n    pass\n  except BaseException: pass")
    bench.scheduler.run()
    error = bench.errors[1]
    assert isinstance(error, BudgetExceeded)
    assert error_line(error, "m.bpmn") == 3
