"""Every rule is shown twice: in a run straight on, and in one whose engine is restored after every stimulus."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from engine_models import Run

Play = Callable[..., Run]


@pytest.fixture(params=["straight", "restored"])
def play(request: pytest.FixtureRequest) -> Play:
    """`Run`, in both ways."""

    def run(*arguments: object, **options: object) -> Run:
        return Run(*arguments, restored=request.param == "restored", **options)  # type: ignore[arg-type]

    return run
