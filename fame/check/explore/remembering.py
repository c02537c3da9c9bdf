"""Unknown conditions whose outcome is remembered: asked again with unchanged variables, they have the same one.

An outcome is kept among the variables of the innermost scope that has one that the condition reads, as the decisions
that led to it. It is forgotten as soon as one of them is set, or may be changed in place: by a script, a message, a
person, a result. While a script with `await` or a behaviour is under way it may set its variables at any time. Not
remembered are conditions with functions that are not known to give the same again, or that read what changes by itself
(`robot.now`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

from fame.bpmn import model
from fame.check.expressions import expressions_in
from fame.engine.data import Variables


class Memory:
    """What is remembered of the conditions of a pool, in all variables of an engine.

    readers   variable -> the conditions that read it, see `key_of`
    scopes    all variables in which outcomes may be kept
    """

    def __init__(self, remembered: Mapping[str, Set[str]]) -> None:
        names = {name for reads in remembered.values() for name in reads}
        self.readers: Mapping[str, Sequence[str]] = {
            name: tuple(key for key, reads in remembered.items() if name in reads) for name in names
        }
        self.scopes: list[Outcomes | InnerOutcomes] = []

    def set(self, name: str, owner: dict[str, Any]) -> None:
        """Forget the outcomes that depend on a variable of some scope."""
        for key in self.readers.get(name, ()):
            for scope in self.scopes:
                if owner_of(scope, name) is owner:
                    scope.forget(key)

    def change(self, names: Iterable[str]) -> None:
        """Forget the outcomes that depend on what variables hold, which those of any scope may hold too."""
        for key in {key for name in names for key in self.readers.get(name, ())}:
            for scope in self.scopes:
                scope.forget(key)


def owner_of(variables: dict[str, Any], name: str) -> dict[str, Any]:
    """Return the variables, of a scope or of one around it, that have a name."""
    while isinstance(variables, Variables) and not dict.__contains__(variables, name):
        variables = variables.outer
    return variables


class InnerOutcomes(Variables):
    """The variables of a scope with variables of its own, with outcomes of the conditions that read one of them."""

    __slots__ = ("memory",)
    inner: type[InnerOutcomes]

    def __init__(self, outer: dict[str, Any], own: Mapping[str, Any] | None = None) -> None:
        super().__init__(outer, own)
        self.memory: Memory = outer.memory  # type: ignore[attr-defined]  # of variables whose `inner` is this class
        self.memory.scopes.append(self)

    def define(self, name: str, value: Any) -> None:
        if not _is_key(name):
            super().define(name, value)
            self.memory.set(name, self)

    def recall(self, key: str) -> tuple[int, ...]:
        """Return the decisions that led to the outcome of a condition; none if it is not known."""
        outcomes: tuple[int, ...] = dict.get(self, key, ())
        return outcomes

    def remember(self, key: str, decisions: tuple[int, ...]) -> None:
        """Keep the decisions that led to the outcome of a condition."""
        super().define(key, decisions)

    def forget(self, key: str) -> None:
        """Let a condition have another outcome."""
        if dict.__contains__(self, key):
            del self[key]


InnerOutcomes.inner = InnerOutcomes


class Outcomes(dict[str, Any]):
    """The variables of an instance, or of a call with variables of its own, with outcomes of conditions."""

    __slots__ = ("memory",)
    inner: type[InnerOutcomes] = InnerOutcomes

    def __init__(self, values: Mapping[str, Any], memory: Memory) -> None:
        super().__init__(values)
        self.memory: Memory = memory
        memory.scopes.append(self)

    def __setitem__(self, name: str, value: Any) -> None:
        if not _is_key(name):
            super().__setitem__(name, value)
            self.memory.set(name, self)

    def update(self, *values: Any, **named: Any) -> None:
        """Take variables of another scope, without its outcomes."""
        super().update({name: value for name, value in dict(*values, **named).items() if not _is_key(name)})

    def recall(self, key: str) -> tuple[int, ...]:
        """Return the decisions that led to the outcome of a condition; none if it is not known."""
        outcomes: tuple[int, ...] = self.get(key, ())
        return outcomes

    def remember(self, key: str, decisions: tuple[int, ...]) -> None:
        """Keep the decisions that led to the outcome of a condition."""
        super().__setitem__(key, decisions)

    def forget(self, key: str) -> None:
        """Let a condition have another outcome."""
        if key in self:
            del self[key]


def memory_of(variables: dict[str, Any], reads: Set[str]) -> Outcomes | InnerOutcomes | None:
    """Where the outcome of a condition is kept: in the innermost variables that have one that it reads."""
    while isinstance(variables, Variables) and not any(dict.__contains__(variables, name) for name in reads):
        variables = variables.outer
    return variables if isinstance(variables, Outcomes | InnerOutcomes) else None


def remembered(bodies: Iterable[model.Body]) -> dict[str, frozenset[str]]:
    """Condition -> the variables that it reads, of the conditions of a pool that are remembered; see `key_of`."""
    reads_by_key, others = dict[str, frozenset[str]](), set[str]()
    for body in bodies:
        others |= {node.loop.output_collection for node in body.nodes if isinstance(node.loop, model.MultiInstance)}
        for use in expressions_in(body):
            if use.effects.unseen:
                return {}
            others |= use.effects.later
            if use.use == "condition" and use.effects.steady and use.effects.reads:
                reads_by_key[key_of(use.expression)] = use.effects.reads
    return {key: reads for key, reads in reads_by_key.items() if not reads & others}


def _is_key(name: str) -> bool:
    return name[:1] == "?"


def key_of(condition: model.Expression) -> str:
    """Return the name under which the outcome of a condition is kept among the variables: no other one is called so."""
    return f"?{condition.language} {' '.join(condition.text.split())}"
