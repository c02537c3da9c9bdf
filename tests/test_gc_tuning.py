"""What changes the collector of garbage does so for its block only."""

import gc
import sys
from collections.abc import Iterator

import pytest

from fame.gc_tuning import MemoryGrowth, exempt, former_exempt, rarely_collected, readmit, uncollected


@pytest.fixture(autouse=True)
def _frozen_again() -> Iterator[None]:
    frozen = gc.get_freeze_count()
    gc.unfreeze()
    yield
    if frozen:
        gc.freeze()


def test_a_block_is_rarely_collected() -> None:
    before = gc.get_threshold()
    with rarely_collected(100_000):
        assert gc.get_threshold()[0] == 100_000
    assert gc.get_threshold() == before


def test_a_block_is_not_collected_and_what_stays_is_exempt() -> None:
    with uncollected(stays=True):
        assert not gc.isenabled()
    assert gc.isenabled()
    assert gc.get_freeze_count() > 0


def test_what_is_there_before_a_block_is_exempt_until_its_end() -> None:
    with former_exempt():
        assert gc.get_freeze_count() > 0
    assert gc.get_freeze_count() == 0


def test_what_is_there_is_exempt_until_it_is_readmitted() -> None:
    exempt()
    assert gc.get_freeze_count() > 0
    readmit()
    assert gc.get_freeze_count() == 0


def test_garbage_is_collected_again_only_when_memory_has_grown(monkeypatch: pytest.MonkeyPatch) -> None:
    collected = list[int]()
    monkeypatch.setattr(gc, "collect", lambda *_: collected.append(1))
    growth = MemoryGrowth()
    growth.collect()
    growth.collect()
    assert len(collected) == 1
    twice = 2 * sys.getallocatedblocks()
    monkeypatch.setattr(sys, "getallocatedblocks", lambda: twice)
    growth.collect()
    assert len(collected) == 2
