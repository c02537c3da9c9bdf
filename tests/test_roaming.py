"""Acknowledged signals between two machines whose link comes and goes: each arrives once, in order."""

import pytest

from benchmarks.roaming import run
from tests.networked_machines import forbidden

pytestmark = pytest.mark.processes


@pytest.mark.parametrize("middleware", ["dds", "zenoh"])
def test_every_signal_arrives_once_and_in_order_over_a_link_that_is_down_half_of_the_time(middleware):
    if why := forbidden():
        pytest.skip(why)
    result = run(middleware, 500)
    assert result["once_and_in_order"], result
    assert result["downs"] > 0
