"""Whatever somebody wrote is read, or refused in one line: damaged input for every reader (docs/damaged_input.md)."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.targets import BY_NAME, TARGETS, Target
from tests.fuzz.trial import failure

FOUND = sorted((Path(__file__).parent / "fuzz" / "found").iterdir())
INPUTS, FEW = 60, 10
"""Inputs of each reader, and of one that takes many milliseconds for each."""


def of_this_machine(target: Target) -> Target:
    """The reader, unless its packages are missing."""
    for package in target.needs:
        pytest.importorskip(package)
    return target


@pytest.mark.long_but("*-0")
@pytest.mark.parametrize("part", range(10))
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_damaged_input_is_read_or_refused_in_one_line(target: Target, part: int) -> None:
    of_this_machine(target)
    assert target.valid
    numbers = range(part, FEW if target.slow else INPUTS, 10)
    failures = {number: failure(target, target.input(number)) for number in numbers}
    assert {number: why for number, why in failures.items() if why} == {}


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_valid_input_is_no_failure(target: Target) -> None:
    of_this_machine(target)
    assert {
        why for why in (failure(target, data) for data in target.valid[:: 10 if target.slow else 1]) if why
    } == set()


@pytest.mark.parametrize("file", FOUND, ids=lambda file: file.name)
def test_what_once_failed_is_read_or_refused(file: Path) -> None:
    target = of_this_machine(BY_NAME[file.name.rpartition("-")[0]])
    assert failure(target, file.read_bytes()) == ""


def test_a_reader_that_raises_another_error_is_a_failure() -> None:
    def read(data: bytes) -> None:
        data[10]

    target = Target("broken", read, lambda: [b"abc"], lambda random, data, others: data)
    assert failure(target, b"abc").startswith("IndexError: 'index out of range'")
    assert failure(target, b"x" * 20) == ""
