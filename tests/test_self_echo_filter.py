"""What a node's own middleware brings back to it is told from what others say."""

from fame.clock import SECOND
from fame.middleware.codec import serialize
from fame.middleware.messages import create
from fame.middleware.self_echo_filter import EchoFilter

YES, NO = (serialize(create("std_msgs/msg/Bool", value)) for value in (True, False))
"""Of five bytes each, behind which a message is padded on its way."""


def padded(data: bytes) -> bytes:
    """As Cyclone DDS hands it over: filled up, and so noted in the header (DDS-XTypes 1.3, section 7.6.3.1.2)."""
    filling = -len(data) % 4
    return data[:3] + bytes([filling]) + data[4:] + bytes(filling)


def test_an_echo_is_dropped_once_padded_or_not() -> None:
    for come_back in (YES, padded(YES)):
        echoes = EchoFilter()
        echoes.expect("publisher", [YES], 0)
        assert [echoes.take(come_back, 1) for _ in range(2)] == [True, False]


def test_what_another_node_says_is_none() -> None:
    echoes = EchoFilter()
    assert not echoes.take(YES, 0)
    echoes.expect("publisher", [YES], 0)
    assert not echoes.take(padded(NO), 1)
    assert echoes.take(padded(YES), 1)


def test_echoes_of_one_publisher_come_in_its_order_so_those_before_a_found_one_were_lost() -> None:
    echoes = EchoFilter()
    echoes.expect("publisher", [YES, NO], 0)
    echoes.expect("other", [YES], 0)
    assert echoes.take(NO, 1)
    assert [echoes.take(YES, 1) for _ in range(2)] == [True, False]


def test_an_echo_that_takes_longer_than_a_second_was_lost() -> None:
    echoes = EchoFilter()
    echoes.expect("publisher", [YES], 0)
    assert not echoes.take(YES, SECOND + 1)
