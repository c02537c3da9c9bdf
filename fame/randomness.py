"""Random numbers of a mission: one source for each robot, and the modules `random` and `numpy.random` in a run."""

from __future__ import annotations

import random
from collections.abc import Collection
from random import Random, SystemRandom
from typing import Any

SEEDS = 2**32
"""Number of seeds that `new_seed` chooses from."""


def robot_random(seed: int, robot: str) -> Random:
    """Return the random numbers of a robot: the same for the same seed, in any process, and
    different for each robot."""
    return Random(f"{seed} robot {robot}")


def new_seed() -> int:
    """Return a seed from the randomness of the operating system."""
    return SystemRandom().randrange(SEEDS)


RANDOM_MODULES = frozenset(("random", "numpy"))


class ModuleRandom:
    """The modules `random` and `numpy.random` (its global functions) as a run sees them; `owner`: seed, robot ...

    ``with`` it, both draw from the run's own state, which continues where the block before ended. After the block they
    are as they were before it. A block inside another one of the same run changes nothing. `modules`: those that the
    run can draw from, of `RANDOM_MODULES`; the others are left alone.
    """

    def __init__(self, *owner: object, modules: Collection[str] = RANDOM_MODULES) -> None:
        self._owner = " ".join(map(str, owner))
        self._modules = modules
        self._depth = 0
        self._inside: tuple[Any, Any] | None = None
        self._outside: tuple[Any, Any] | None = None

    def __enter__(self) -> None:
        self._depth += 1
        if self._depth > 1 or not self._modules:
            return
        self._outside = self._states()
        if self._inside is not None:
            self._restore(self._inside)
            return
        random.seed(self._owner)
        if "numpy" in self._modules:
            _numpy_random().seed(Random(f"{self._owner} numpy").randrange(SEEDS))

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0 and self._outside is not None:
            self._inside = self._states()
            self._restore(self._outside)

    def _states(self) -> tuple[Any, Any]:
        if "numpy" not in self._modules:
            return random.getstate(), None
        state = _numpy_random().get_state(legacy=False)
        if "key" in state["state"]:
            state["state"]["key"] = state["state"]["key"].tolist()  # which numpy sets far faster than an array
        return random.getstate(), state

    def _restore(self, states: tuple[Any, Any]) -> None:
        random.setstate(states[0])
        if states[1] is not None:
            _numpy_random().set_state(states[1])


def _numpy_random() -> Any:
    """Return `numpy.random`, which takes long to import."""
    from numpy import random as numpy_random

    return numpy_random
