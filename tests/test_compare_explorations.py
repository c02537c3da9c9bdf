"""Explorations of collaborations made at random say what their runs show, and the other way round."""

from pathlib import Path

import pytest
from compare_explorations import compare

_MODELS = 50
_PARTS = 10


@pytest.mark.parametrize("part", range(_PARTS))
def test_exploration_and_runs_agree(part: int, tmp_path: Path) -> None:
    compared = [compare(seed, tmp_path) for seed in range(part, _MODELS, _PARTS)]
    assert [text for _, found in compared for text in found] == []
    assert sum(whole for whole, _ in compared) >= len(compared) // 2
