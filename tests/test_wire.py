"""What robots publish in one process can be written for the wire, and reads the same."""

import pytest
from grounds import Ground

from fame.middleware import codec
from sim2d.robot import BUILT_IN


@pytest.mark.parametrize("kind", BUILT_IN)
def test_what_a_robot_publishes_can_be_written_for_the_wire(kind: str) -> None:
    robot = {"type": kind, "at": [1, 2]}
    ground = Ground({"size": [6, 4], "step": 0.002 if kind in ("mh5", "ur5e") else 0.05, "robots": {"REX": robot}})
    types = {info.name: info.types[0] for info in ground.middleware.graph() if info.publishers}
    heard = {topic: ground.hear(topic, type) for topic, type in types.items()}
    ground.run(until=1)
    assert any(heard.values())
    for topic, messages in heard.items():
        for message in messages[-1:]:
            data = codec.serialize(message)
            assert codec.serialize(codec.deserialize(data, types[topic])) == data
