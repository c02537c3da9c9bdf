"""Every rule is shown three times: straight on, restored after every stimulus, and recorded as in a journal."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from engine_models import Run

Play = Callable[..., Run]


@pytest.fixture(params=["straight", "restored", "recorded"])
def play(request: pytest.FixtureRequest) -> Play:
    """`Run`, in these ways."""

    def run(*arguments: object, **options: object) -> Run:
        return Run(*arguments, after=request.param, **options)  # type: ignore[arg-type]

    return run
