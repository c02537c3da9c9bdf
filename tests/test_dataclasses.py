"""Dataclasses are as those of the standard library, but their methods are compiled when they are first asked for."""

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import pytest

import fame.dataclasses
from fame.dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Place:
    """Where something is."""

    x: float
    y: float = 0.0
    marks: list[str] = field(default_factory=list, compare=False)
    name: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        if self.x < 0:
            raise ValueError("x")


@dataclass(frozen=True, slots=True, kw_only=True)
class Station(Place):
    z: int = 3


@dataclass(slots=True)
class Count:
    n: int = 0

    def __repr__(self) -> str:
        return f"{self.n} times"


@dataclass(slots=True, eq=False)
class Token:
    n: int = 0


def declare(kind: Callable[..., Any], **options: bool) -> Any:
    class Pair:
        a: int
        b: tuple[int, ...] = (1,)

    return kind(Pair, slots=True, **options)


@pytest.mark.parametrize("options", [{}, {"frozen": True}, {"frozen": True, "kw_only": True}, {"eq": False}])
def test_a_class_is_as_the_standard_library_makes_it(options: dict[str, bool]) -> None:
    ours, theirs = declare(dataclass, **options), declare(dataclasses.dataclass, **options)
    assert inspect.signature(ours) == inspect.signature(theirs)
    assert repr(ours(a=2)) == repr(theirs(a=2))
    for kind in (ours, theirs):
        assert (kind(a=2) == kind(a=2)) is options.get("eq", True)
        assert (kind.__hash__ is None) is (not options.get("frozen") and options.get("eq", True))
        assert dataclasses.asdict(dataclasses.replace(kind(a=2), b=())) == {"a": 2, "b": ()}
    if options.get("frozen"):
        assert hash(ours(a=2)) == hash(theirs(a=2))
        for change in (lambda one: setattr(one, "a", 3), lambda one: delattr(one, "a")):
            errors = []
            for kind in (ours, theirs):
                with pytest.raises(dataclasses.FrozenInstanceError) as error:
                    change(kind(a=2))
                errors.append(str(error.value))
            assert errors[0] == errors[1]


def test_fields_have_their_defaults_and_are_inherited() -> None:
    one, other = Place(1, name="A"), Place(1)
    assert (one.y, one.marks, one == other, one.marks is other.marks) == (0.0, [], False, False)
    assert one == Place(1, marks=["x"], name="A")
    assert repr(Station(x=1, z=4)) == "Station(x=1, y=0.0, marks=[], name='', z=4)"
    with pytest.raises(ValueError, match="x"):
        Station(x=-1)
    with pytest.raises(TypeError, match=r"Place.__init__\(\) missing 1 required positional argument: 'x'"):
        Place()  # type: ignore[call-arg]
    assert repr(Count(2)) == "2 times" != repr(Token())
    assert Token() != Token()


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_what_is_frozen_can_be_copied_and_sent(again: Callable[[Any], Any]) -> None:
    assert again(Station(x=1, z=4)) == Station(x=1, z=4)
    assert again(Count(2)) == Count(2)


def test_nothing_is_compiled_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[object] = []
    make = dataclasses.make_dataclass
    monkeypatch.setattr(fame.dataclasses.dataclasses, "make_dataclass", lambda *a, **o: made.append(a) or make(*a, **o))
    Pair = declare(dataclass, frozen=True)
    assert len(made) == 0
    assert [Pair(1).a, Pair(2).a] == [1, 2]
    assert len(made) == 1


def test_a_class_of_the_standard_library_may_derive_from_a_frozen_one() -> None:
    @dataclass(frozen=True, slots=True)
    class Ours:
        x: int = 1

    @dataclasses.dataclass(frozen=True, slots=True)
    class Theirs(Ours):
        y: int = 2

    @dataclass(frozen=True, slots=True)
    class Again(Theirs):
        z: int = 3

    assert (Theirs(4), Again(4, 5)) == (Theirs(x=4, y=2), Again(x=4, y=5, z=3))
    assert hash(Theirs(4)) == hash(Theirs(4))
    with pytest.raises(dataclasses.FrozenInstanceError):
        Again().x = 2  # type: ignore[misc]
