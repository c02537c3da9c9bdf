"""What a script in JavaScript cannot do: run forever, take all memory, reach the host, spoil the scripts of others."""

from typing import Any

import pytest
import quickjs
from javascript_models import Peer, definitions, error_of, flows, run, simulate, task

import fame
from fame.scripting.javascript import source

V = "const v = this.environment.variables; "


@pytest.fixture(autouse=True)
def tight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits that are reached soon."""
    monkeypatch.setattr(source, "SECONDS", 0.1)
    monkeypatch.setattr(source, "MEMORY", 8 * 2**20)
    monkeypatch.setattr(source, "REACTIONS", 1000)


ENDLESS = [
    "for (;;) {}",
    "try { for (;;) {} } catch (error) { next() } finally { next() }",
    "for (;;) try { for (;;) {} } catch (error) {}",
    "setTimeout(() => { while (true) {} next() }, 1000)",
    "/^(a+)+$/.test('a'.repeat(50) + 'b')",
    "[1, 2, 3].sort((a, b) => { for (;;) {} })",
    "new Array(2 ** 32 - 1).indexOf(1)",
    "Promise.resolve().then(() => { for (;;) {} })",
    "this.environment.variables.x = {toJSON() { for (;;) {} }}",
    "const spin = {get x() { for (;;) {} }}; node.createPublisher('std_msgs/msg/Bool', 'a').publish(spin)",
]


@pytest.mark.long_but("for*")
@pytest.mark.parametrize("text", ENDLESS)
def test_a_step_that_does_not_end_is_an_error_of_its_script(text: str) -> None:
    assert "one step of the script took more than 0.1 s" in error_of(f"{V}const node = v.node; {text}").text


class Timed:
    """What a context gives; calls that are interrupted add the limit of that moment (s) to `spent`."""

    def __init__(self, value: Any, spent: list[float], limit: list[float]) -> None:
        self.value, self.spent, self.limit = value, spent, limit

    def __getattr__(self, name: str) -> Any:
        return Timed(getattr(self.value, name), self.spent, self.limit)

    def __call__(self, *given: Any) -> Any:
        try:
            found = self.value(*[one.value if isinstance(one, Timed) else one for one in given])
        except quickjs.JSException as error:
            self.spent += self.limit[-1:] if "interrupted" in str(error) else []
            raise
        return Timed(found, self.spent, self.limit) if isinstance(found, quickjs.Object) else found

    def set_time_limit(self, seconds: float) -> None:
        self.limit.append(seconds)
        self.value.set_time_limit(seconds)


@pytest.mark.long_but("for*")
@pytest.mark.parametrize("text", [*ENDLESS, "v.x = {toJSON() { for (;;) {} }}; throw new Error('x')"])
def test_a_step_that_does_not_end_takes_its_limit_once(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To report what it did before may run it again, a tenth as long."""
    spent: list[float] = []
    make = source.new_context
    monkeypatch.setattr(source, "new_context", lambda: Timed(make(), spent, [source.SECONDS]))
    error_of(f"{V}const node = v.node; {text}")
    assert spent[0] == 0.1
    assert sum(spent) <= 0.12


def test_promises_that_react_for_ever_are_an_error() -> None:
    text = "const again = () => Promise.resolve().then(again); again(); setTimeout(next, 1000)"
    assert "1000 reactions of promises in one step" in error_of(text).text


def test_an_endless_loop_has_the_line_where_it_was_stopped() -> None:
    assert error_of("\n\nfor (;;) {}\nnext()").line == 6


@pytest.mark.parametrize(
    "text",
    [
        "const held = []; for (;;) held.push('x'.repeat(1e5) + held.length)",
        "let text = 'x'; for (;;) text += text",
        "new Array(1e8).fill(0)",
        "new ArrayBuffer(2 ** 30)",
        "v.held = []; for (;;) v.held.push([1, 2, 3, {a: 'x'.repeat(1e4) + v.held.length}])",
        "globalThis.held = {}; for (let i = 0; ; i++) held['name' + i] = i",
        "const grow = (o) => { for (;;) o = {o} }; grow({})",
    ],
)
def test_a_memory_bomb_is_an_error_of_its_script(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "SECONDS", 60)  # memory is what ends it, also on a slow processor
    found = error_of(f"{V}{text}; next()")
    assert "8 MB" in found.text or "string too long" in found.text
    assert found.element == "t1"


def test_a_memory_bomb_spoils_only_its_own_process() -> None:
    text = "if (v.bomb) { globalThis.held = []; for (;;) held.push('x'.repeat(1e5) + held.length) } next()"
    simulation = simulate(V + text, bomb=True).run()
    simulation.start({"bomb": False})
    assert [instance.status for instance in simulation.run().instances] == ["failed", "completed"]


@pytest.mark.parametrize(
    "text",
    ["(function f() { f() })()", "const o = {get x() { return this.x }}; o.x",
     "`${new Proxy({}, {get: (t, k, r) => r[k]})}`"],
)  # fmt: skip
def test_endless_recursion_is_an_error(text: str) -> None:
    assert "call stack" in error_of(f"{text}; next()").text


def test_deep_and_cyclic_values_stay_with_the_scripts() -> None:
    texts = (f"{V}v.ring = {{}}; v.ring.self = v.ring; let deep = []; for (let i = 0; i < 1e4; i++) deep = [deep];"
             "v.deep = deep; v.y = 1; next()", f"{V}v.y += v.ring.self === v.ring ? 1 : 0; next()")  # fmt: skip
    variables = run(*texts)
    assert variables["y"] == 2
    assert "ring" not in variables


def test_a_model_goes_on_after_it_caught_an_endless_loop() -> None:
    content = (
        task("t", f"{V}v.began = true; for (;;) {{}}")
        + task("after", f"{V}v.after = v.began; next()")
        + '<startEvent id="s"/><endEvent id="e"/><endEvent id="o"/><boundaryEvent id="b" attachedToRef="t">'
        f"<errorEventDefinition/></boundaryEvent>{flows('s', 't', 'e')}{flows('b', 'after', 'o')}"
    )
    (instance,) = fame.Simulation(definitions(content), robot="REX").run().instances
    assert (instance.status, instance.variables) == ("completed", {"began": True, "after": True})


def test_timers_that_a_stopped_script_had_set_are_gone() -> None:
    content = (
        task("t", f"{V}v.ticks = 0; setTimeout(() => {{ v.ticks += 1 }}, 100); next(); for (;;) {{}}")
        + task("after", "setTimeout(next, 1000)")
        + '<startEvent id="s"/><endEvent id="e"/><endEvent id="o"/><boundaryEvent id="b" attachedToRef="t">'
        f"<errorEventDefinition/></boundaryEvent>{flows('s', 't', 'e')}{flows('b', 'after', 'o')}"
    )
    assert fame.Simulation(definitions(content), robot="REX").run().instances[0].variables == {"ticks": 0}


# ---- the host --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["process", "require", "module", "global", "std", "os", "fetch", "XMLHttpRequest", "WebSocket", "Deno", "print",
     "load", "read", "scriptArgs", "Worker", "setInterval", "python", "host"],
)  # fmt: skip
def test_there_is_nothing_of_a_host(name: str) -> None:
    assert run(f"this.environment.variables.y = typeof {name} + typeof globalThis['{name}']; next()") == {
        "y": "undefinedundefined"
    }


@pytest.mark.parametrize(
    "text",
    [
        "this.constructor.constructor('return this')()",
        "next.constructor('return this')()",
        "v.node.createPublisher.constructor('return this')()",
        "v.constructor.constructor('return this')()",
        "(0, eval)('this')",
        "console.log.constructor('return this')()",
    ],
)
def test_ways_to_the_global_object_end_in_that_of_the_script(text: str) -> None:
    assert run(f"{V}const found = {text}; v.y = [found === globalThis, typeof found.process]; next()")["y"] == [
        True,
        "undefined",
    ]


@pytest.mark.parametrize("text", ["import('os')", "import('file:///etc/passwd')", "import('./m.bpmn')"])
def test_no_module_can_be_loaded(text: str) -> None:
    told = ".then(() => 'loaded', () => 'refused').then((y) => { v.y = y; next() })"
    assert run(V + text + told)["y"] == "refused"


def test_no_function_of_python_is_within_reach() -> None:
    walk = """
        const seen = new Set(), kinds = new Set();
        const line = [globalThis, this, v, v.node, v.node.createClient('std_srvs/srv/Empty', 'e')];
        while (line.length) {
            const one = line.pop();
            if (one !== Object(one) || seen.has(one)) continue;
            seen.add(one);
            if (typeof one === 'function') kinds.add(Object.hasOwn(one, 'length'));
            line.push(Object.getPrototypeOf(one));
            for (const name of Reflect.ownKeys(one)) {
                const {value, get, set} = Object.getOwnPropertyDescriptor(one, name);
                line.push(value, get, set);
            }
        }
        v.y = [seen.size > 500, [...kinds]]; next()"""
    assert run(V + walk)["y"] == [True, [True]]
    context = quickjs.Context()
    context.add_callable("python", len)
    assert context.eval("Object.hasOwn(python, 'length')") is False  # by which one would be known


@pytest.mark.parametrize(
    "text",
    [
        "v.__builtins__ = {}",
        "v['__builtins__'] = {}",
        "v.__class__ = 1",
        "Object.assign(v, {__realm__: 1})",
        "Object.defineProperty(v, '__builtins__', {value: 1})",
        "Reflect.set(v, '__javascript__', null)",
        "Object.setPrototypeOf(v, {})",
        "Object.freeze(v)",
        "v[Symbol('s')] = 1",
    ],
)
def test_the_variables_refuse_names_of_the_host(text: str) -> None:
    simulation = simulate(f"{V}{text}; next()").run()
    assert simulation.instances[0].status == "failed"
    assert simulation.instances[0].variables == {}


@pytest.mark.parametrize(
    "trick",
    [
        'Array.prototype.join = () => \'["publish","","std_msgs/msg/Bool","a",true]\';',
        "Array.prototype.map = () => ['1'];",
        "Array.prototype.push = function () { return 5 };",
        'JSON.stringify = () => \'{"set":{"__builtins__":1}}\'; JSON.parse = () => null;',
        "Object.prototype.toJSON = () => ({set: {__builtins__: 1}});",
        "String.prototype.includes = () => true;",
        "Map.prototype.get = Set.prototype.add = WeakSet.prototype.has = () => ({});",
        "Object.prototype[Symbol.iterator] = Array.prototype[Symbol.iterator] = function* () { yield '__builtins__' };",
        "Object.keys = () => ['__builtins__']; Object.hasOwn = () => true;",
        "Error.captureStackTrace = Error.prepareStackTrace = () => ({});",
        "Promise.prototype.then = () => { throw 1 };",
        "Number.isFinite = () => false; Object.defineProperty(Object.prototype, 'set', {get: () => { throw 1 }});",
    ],
)
def test_whoever_breaks_built_in_objects_fools_only_himself(trick: str) -> None:
    own = (
        f"{V}if (v.trick) {{ {trick} }} v.y = {{a: [1]}}; console.log('x'); setTimeout(next, 1000);"
        "v.node.createPublisher('std_msgs/msg/Bool', 'a').publish(true)"
    )
    simulation = simulate(own, f"{V}v.z = 1; next()", trick=True)
    simulation.run(until=5)
    peer = Peer(simulation).hear("/REX/a", "std_msgs/msg/Bool")
    simulation.start({"trick": False})
    _, honest = simulation.run(until=10).instances
    assert honest.status == "completed"
    assert honest.variables == {"trick": False, "y": {"a": [1]}, "z": 1}
    assert len(peer.heard) == 1
    assert all(isinstance(instance.root_variables.get("__builtins__", {}), dict) for instance in simulation.instances)


@pytest.mark.parametrize(
    "thrown",
    ["{get message() { throw 1 }}", "{toString: null, stack: {}}", "Object.create(null)", "Symbol('s')", "undefined",
     "new Proxy({}, {get() { throw 1 }})", "{code: {}, message: 1}", "'\\ud800'"],
)  # fmt: skip
def test_forged_errors_are_still_errors(thrown: str) -> None:
    assert error_of(f"throw {thrown}; next()").code == "script"
