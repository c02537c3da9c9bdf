"""The reduced search finds what the full search finds, on collaborations made at random."""

import pytest
from bpmn_text import extensions, process
from collaborations import Steps, generated, philosophers, team, text_of, varied, with_lists
from compare_explorations import verdicts

import fame
from fame.check.explore import Request, abstraction as abstracting
from fame.check.explore.liveness import Liveness
from fame.check.explore.product import Options, Product
from fame.check.explore.search import explore as search
from fame.check.explore.stubborn import Outlook
from fame.check.explore.team import Team
from fame.check.explore.transitions import CUT
from fame.scenario.explore.exploration import cast_of, explore

_LIMIT = 1_500
_SEEDS = 120
_PARTS = 12


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(_PARTS))
def test_reduced_and_full_search_agree(part: int) -> None:
    compared = smaller = 0
    for seed in range(part, _SEEDS, _PARTS):
        model = team(generated(seed), several=("R0",) if seed % 3 == 0 else ())
        delivery = ("run", "fast", "any")[seed // 3 % 3]
        full = explore(model, delivery=delivery, reduced=False, limit=_LIMIT, samples=False)
        if full.exhaustive:
            reduced = explore(model, delivery=delivery, limit=_LIMIT, samples=False)
            assert verdicts(reduced) == verdicts(full), f"seed {seed}, delivery {delivery}"
            assert reduced.states <= full.states
            compared += 1
            smaller += reduced.states < full.states
    assert compared >= _SEEDS // _PARTS // 2
    assert smaller


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(_PARTS))
def test_robots_that_drop_triggers_while_they_run(part: int) -> None:
    """Nobody notices what they do meanwhile, although they listen."""
    compared = smaller = 0
    for seed in range(part, _SEEDS, _PARTS):
        robots = generated(seed, size=2)
        first, *steps = robots["R1"]
        robots["R1"] = ["start a", first, "work", "work", *steps]
        robots["R0"] = ["throw a", "work", *robots["R0"]]
        model = team(robots, several=("R1",) if seed % 3 == 0 else (), single=("R1",))
        delivery = ("run", "fast", "any")[seed // 3 % 3]
        full = explore(model, delivery=delivery, reduced=False, limit=_LIMIT, samples=False)
        if full.exhaustive:
            reduced = explore(model, delivery=delivery, limit=_LIMIT, samples=False)
            assert verdicts(reduced) == verdicts(full), f"seed {seed}, delivery {delivery}"
            compared += 1
            smaller += reduced.states < full.states
    assert compared >= _SEEDS // _PARTS // 3
    assert smaller


def test_philosophers_need_far_fewer_states_by_stubborn_sets() -> None:
    """Their requests meet only at forks: most orders of what they do make no difference."""
    for ordered in (True, False):
        model = team(philosophers(4, ordered=ordered))
        full, reduced = (explore(model, delivery="run", reduced=one, samples=False) for one in (False, True))
        assert verdicts(reduced) == verdicts(full)
        assert [len(one.run) for one in reduced.findings] == [len(one.run) for one in full.findings]
        assert reduced.states < 0.75 * full.states


def test_an_end_of_the_mission_is_not_passed_over() -> None:
    """B may start at any time, also when A is done: the mission can end while B has never started."""
    model = team({"A": ["work", "throw a"], "B": ["start b", "work"], "C": ["work", "throw b"]})
    assert verdicts(explore(model, delivery="run")) == verdicts(explore(model, delivery="run", reduced=False))


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(_PARTS))
def test_no_robot_sends_what_its_outlook_does_not_know(part: int) -> None:
    """What a robot sends in a step was to be expected before, and so was all that is to be expected after it."""
    sent, bits = 0, dict[str, int]()
    for seed in range(part, 60, _PARTS):
        robots, options = varied(seed)
        definitions, library, cast = cast_of(fame.read(text_of(robots, **options).encode()), {}, ())
        found = Team(definitions, library, cast, Request())
        product = Product(found.robots, found.locals, Options(reduced=False, limit=_LIMIT))
        search(product)
        outlooks = [Outlook(local, lambda topic: bits.setdefault(topic, 1 << len(bits))) for local in found.locals]
        for outlook, own, hears in zip(outlooks, product._own, product._hears, strict=True):
            steps = [(state, 0, move) for state, moves in own.items() for move in moves]
            steps += [(state, bits.get(topic, 0), move) for (state, topic, _), moves in hears.items() for move in moves]
            for state, given, move in steps:
                if state < CUT and move.state < CUT:
                    expected = outlook.sends(state, given)
                    assert all(expected & bits[topic] for topic, *_ in move.successor.sent), (
                        f"seed {seed}: {move.stimulus}"
                    )
                    assert outlook.sends(move.state, given) & ~expected == 0, f"seed {seed}: {move.stimulus}"
                    sent += len(move.successor.sent)
    assert sent


def told_apart(robots: dict[str, Steps]) -> dict[str, Steps]:
    """The same robots, of which those of R0 know their names and tell them."""
    return {**robots, "R0": ["run me = robot.name", *robots["R0"]]}


@pytest.mark.long_but("0")
@pytest.mark.parametrize("part", range(_PARTS))
def test_what_decides_nothing_changes_no_verdict(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dead variables, items of counted lists, and statements that decide nothing may as well be kept."""
    models = [(seed, team(told_apart(with_lists(seed)), several=("R0",) if seed % 4 == 0 else ()))
              for seed in range(part, _SEEDS, _PARTS)]  # fmt: skip
    small = {seed: explore(model, delivery="run", limit=_LIMIT // 2, samples=False) for seed, model in models}
    models = [(seed, model) for seed, model in models if small[seed].exhaustive]  # the others are larger still
    monkeypatch.setattr(Liveness, "dead", lambda self, waiting: (frozenset(), frozenset()))
    monkeypatch.setattr(abstracting, "sliced", lambda script, needed: script)
    monkeypatch.setattr(abstracting, "without_items", lambda script, counted, may_fail: script)
    monkeypatch.setattr(abstracting, "without_operations", lambda script, unknown: script)
    compared = 0
    for seed, model in models:
        large = explore(model, delivery="run", limit=_LIMIT // 2, samples=False)
        if large.exhaustive:
            assert verdicts(small[seed], "error") == verdicts(large, "error"), f"seed {seed}"
            assert small[seed].states <= large.states
            compared += 1
    assert compared >= _SEEDS // _PARTS // 3


def test_a_value_that_nothing_reads_any_more_makes_no_states() -> None:
    counting: Steps = ["run x = 0", ("loop", ["work", "run x = (x + 1) % 9", ("if", "x == 5", ["work"], [])])]
    short, longer = (explore(team({"A": [*counting, *["work"] * count]})).local["A"] for count in (1, 2))
    assert longer == short + 1  # not one for each value


@pytest.mark.parametrize("guard", ["at the task", "at its caller"])
@pytest.mark.parametrize("failing", ["x.append(d[3])", "x.append(1 / len(x))", "z = odom - d[0]", "z = d[3]"])
def test_what_fails_where_an_error_event_catches_it_is_kept(failing: str, guard: str) -> None:
    """It may decide nothing else, as items of counted lists, and operations on what is unknown."""
    begun: Steps = ["run x = []; d = [1]", "catch odom"]
    inside: Steps = [f"run {failing}", "throw passed"]
    if guard == "at the task":
        robots = {"A": [*begun, ("guard", inside, "error", ["throw gave"])]}
    else:
        robots = {"A": [("guard", [("call", "P")], "error script", ["throw gave"])], "P": [*begun, *inside]}
    robots |= {"B": ["catch gave"], "C": [("race", ["catch passed"], ["catch gave"])]}
    found = explore(fame.read(text_of(robots, calls=("P",)).encode()), delivery="run", samples=False)
    assert [str(one) for one in found.findings if one.level == "error"] == []


@pytest.mark.parametrize("failing", ["x[0] = 1", "x.pop()", "x.remove(3)", "if True: x += 1"])
def test_what_only_changes_a_value_may_fail(failing: str) -> None:
    """Nothing else reads the value, or not before it is set again."""
    robots = {"A": ["run x = []", "work", ("guard", [f"run {failing}"], "error", ["throw gave"])], "B": ["catch gave"]}
    found = explore(fame.read(text_of(robots).encode()), delivery="run", samples=False)
    assert [str(one) for one in found.findings if one.level == "error"] == []
    alone = {"A": ["run x = []", "work", f"run {failing}", "work", "run x = [1]", ("if", "len(x) > 3", ["work"], [])]}
    found = explore(fame.read(text_of(alone).encode()), delivery="run", samples=False)
    assert [one.kind for one in found.findings if one.level == "error"] == ["error"]


_OUTPUT = '<camunda:inputOutput><camunda:outputParameter name="n">5</camunda:outputParameter></camunda:inputOutput>'


def _asks(name: str, after: str = "") -> str:
    return extensions(f'<camunda:formData><camunda:formField id="{name}" type="long"/></camunda:formData>{after}')


def _unreachable(branch: str, behind: str = '<task id="X"/>', condition: str = "n != 0") -> list[str]:
    """What of two branches is called unreachable: U and X behind it, and W with a decision behind it."""
    ways = [("S", "I"), ("I", "F"), ("F", "W"), ("F", "U"), ("W", "G"), ("U", "X")]
    text = process(
        '<startEvent id="S"/><scriptTask id="I"><script>n = 0; xs = []</script></scriptTask><parallelGateway id="F"/>'
        f'<userTask id="W">{_asks("x")}</userTask>{branch}<exclusiveGateway id="G" default="N"/>{behind}'
        + "".join(f'<sequenceFlow id="{a}{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in ways)
        + '<task id="Y"/><task id="Z"/><sequenceFlow id="N" sourceRef="G" targetRef="Z"/><sequenceFlow id="GY" '
        f'sourceRef="G" targetRef="Y"><conditionExpression>{condition}</conditionExpression></sequenceFlow>',
        '<signal id="Sig" name="~/n"/>',
    )
    return [one.text for one in explore(fame.read(text.encode())).findings if one.kind == "unreachable"]


@pytest.mark.parametrize(
    "sets",
    [
        f'<userTask id="U">{_asks("n")}</userTask>',
        '<manualTask id="U"/>',
        f'<userTask id="U">{_asks("x", _OUTPUT)}</userTask>',
        '<intermediateCatchEvent id="U"><signalEventDefinition signalRef="Sig"/></intermediateCatchEvent>',
    ],
    ids=["form", "anything", "mapping", "message"],
)
def test_what_a_branch_sets_that_another_one_reads_is_set_before_it_and_after_it(sets: str) -> None:
    """Only before: what comes behind a decision on the value that is set later was called unreachable."""
    assert _unreachable(sets) == []


@pytest.mark.parametrize(
    "text", ["xs.append(3)", "list.append(xs, 3)", "xs[:] = [3]", "import lib; lib.fill(xs)", "globals()['xs'] = [3]"]
)
def test_what_a_branch_changes_in_place_is_changed_before_and_after_another_one_reads_it(text: str) -> None:
    script = f'<scriptTask id="X"><script>{text}</script></scriptTask>'
    assert _unreachable(f'<userTask id="U">{_asks("k")}</userTask>', script, "len(xs) == 1") == []
