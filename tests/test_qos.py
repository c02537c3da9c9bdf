"""Quality of service as models write it, and which ends of a topic understand each other."""

from typing import Any

import pytest
from hypothesis import given, strategies as st

from fame.errors import ConfigError, MessageError
from fame.middleware.interface import LATCHED, SENSOR_DATA, SIGNAL, QoS
from fame.middleware.qos import compatible, parse
from fame.middleware.wire_base import lease


def test_no_policies_give_the_defaults_of_a_signal() -> None:
    assert parse({}) == SIGNAL == QoS(reliability="reliable", durability="volatile", history="keep_last", depth=100)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("reliability", "best_effort", QoS(reliability="best_effort")),
        ("qos.reliability", "BEST_EFFORT", QoS(reliability="best_effort")),
        ("reliability", "best-effort", QoS(reliability="best_effort")),
        ("reliability", "0", QoS(reliability="best_effort")),
        ("reliability", 1, QoS(reliability="reliable")),
        ("durability", "0", QoS(durability="transient_local")),
        ("durability", "1", QoS(durability="volatile")),
        ("history", "0", QoS(history="keep_last")),
        ("history", "1", QoS(history="keep_all")),
        ("liveliness", "0", QoS(liveliness="automatic")),
        ("liveliness", "manual_by_topic", QoS(liveliness="manual_by_topic")),
        ("depth", "5", QoS(depth=5)),
        ("deadline", "0.5", QoS(deadline=0.5)),
        ("deadline", "1e-3", QoS(deadline=0.001)),
        ("lifespan", 2, QoS(lifespan=2.0)),
        ("leaseDuration", "5", QoS(lease_duration=5.0)),
        ("lease_duration", "infinite", QoS(lease_duration=None)),
        ("deadline", "0", QoS(deadline=None)),
        ("deadline", "inf", QoS(deadline=None)),
    ],
)
def test_a_policy_is_a_name_a_code_or_a_number(name: str, value: Any, expected: QoS) -> None:
    assert parse({name: value}) == expected


def test_policies_are_merged_into_a_base() -> None:
    assert parse({"depth": "1", "durability": "transient_local"}) == LATCHED
    assert parse({"depth": "7"}, SENSOR_DATA) == QoS(reliability="best_effort", depth=7)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("reliability", "good", "qos.reliability: expected best_effort (0) or reliable (1), got 'good'"),
        ("history", "2", "qos.history: expected keep_last (0) or keep_all (1), got '2'"),
        ("depth", "0", "qos.depth: expected a number of messages, from 1 on, got '0'"),
        ("depth", "9999999999", "qos.depth: expected a number of messages, from 1 on, got '9999999999'"),
        ("depth", "10000000000000", "qos.depth: expected a number of messages, from 1 on, got '10000000000000'"),
        ("depth", "²", "qos.depth: expected a number of messages, from 1 on, got '²'"),
        ("deadline", "-1", "qos.deadline: expected a time in seconds, or infinite, got '-1'"),
        ("lifespan", "nan", "qos.lifespan: expected a time in seconds, or infinite, got 'nan'"),
        ("leaseDuration", "5s", "qos.lease_duration: expected a time in seconds, or infinite, got '5s'"),
    ],
)
def test_a_bad_value_is_refused_with_the_policy_and_what_is_accepted(name: str, value: str, text: str) -> None:
    with pytest.raises(MessageError) as caught:
        parse({name: value})
    assert str(caught.value) == text


def test_an_unknown_policy_is_refused_with_those_there_are() -> None:
    with pytest.raises(MessageError, match=r"qos\.speed: there is no such policy; the policies are history, .*depth"):
        parse({"speed": "1"})


@pytest.mark.parametrize(
    ("offered", "requested", "reason"),
    [
        (QoS(), QoS(), None),
        (QoS(), SENSOR_DATA, None),
        (SENSOR_DATA, QoS(), "reliability: offered best_effort, requested reliable"),
        (LATCHED, QoS(), None),
        (QoS(), LATCHED, "durability: offered volatile, requested transient_local"),
        (QoS(depth=1), QoS(depth=50, history="keep_all"), None),
        (QoS(lifespan=1), QoS(lifespan=2), None),
        (QoS(deadline=1), QoS(), None),
        (QoS(deadline=1), QoS(deadline=1), None),
        (QoS(deadline=2), QoS(deadline=1), "deadline: offered 2 s, requested 1 s"),
        (QoS(), QoS(deadline=0.5), "deadline: offered infinite, requested 0.5 s"),
        (QoS(liveliness="manual_by_topic"), QoS(), None),
        (QoS(), QoS(liveliness="manual_by_topic"), "liveliness: offered automatic, requested manual_by_topic"),
        (QoS(lease_duration=3), QoS(lease_duration=2), "lease_duration: offered 3 s, requested 2 s"),
    ],
)
def test_a_subscription_must_not_request_more_than_is_offered(offered: QoS, requested: QoS, reason: str | None) -> None:
    assert compatible(offered, requested) == reason


times = st.none() | st.sampled_from([0.5, 1.0, 2.0])
profiles = st.builds(
    QoS,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    deadline=times,
    liveliness=st.sampled_from(["automatic", "manual_by_topic"]),
    lease_duration=times,
)


@given(profiles)
def test_every_profile_is_compatible_with_itself(profile: QoS) -> None:
    assert compatible(profile, profile) is None


@given(profiles, profiles, profiles)
def test_who_offers_at_least_what_another_offers_satisfies_whom_the_other_satisfies(a: QoS, b: QoS, c: QoS) -> None:
    if compatible(a, b) is None and compatible(b, c) is None:
        assert compatible(a, c) is None


@pytest.mark.parametrize("text", ["soon", "0", "nan", "1e9"])
def test_a_lease_that_is_no_time_is_refused(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert lease(3.0) == 3.0
    monkeypatch.setenv("FAME_LEASE", text)
    with pytest.raises(ConfigError, match=r"FAME_LEASE: expected a time from 0.5 to 3600 s"):
        lease(3.0)
