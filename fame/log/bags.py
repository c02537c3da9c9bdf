"""Judges the properties of a team from what ``ros2 bag record`` has of it: a folder of rosbag2, in either storage.

A bag has the events that robots publish (``/<robot>/bpmn_events``) and their models, as a recorder on the network gets
them. It does not say how far the clocks of two robots differ, so a bound between their events is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from fame.bpmn.model import Definitions
from fame.clock import Scheduler
from fame.errors import ConfigError
from fame.log.bag_reader import open_bag
from fame.log.live_judge import LiveJudge
from fame.log.live_team import LiveTeam
from fame.middleware.interface import MAX_MESSAGE_SIZE
from fame.properties import Judgement, Property, Vocabulary
from fame.robot.robot_state import EVENTS_TOPIC, MODEL_TOPIC
from fame.text import read_json


def judge_bag(
    path: Path, properties: Sequence[Property], model: Definitions | None, team: Vocabulary | None
) -> list[Judgement]:
    """Return the judgements about a bag; `model` and `team` as for `judge_log`. Raises ConfigError for a broken one."""
    judge, scheduler = LiveJudge(properties, model, team), Scheduler()
    robots = LiveTeam(None, None, scheduler, judge.put)
    first: int | None = None
    with open_bag(path) as reader:
        channels = {name: judge.message_channel(name, topic.type, "") for name, topic in reader.topics.items()}
        for stamp, topic, data in reader.contents(channels):
            first = stamp if first is None else first
            scheduler.run(max(scheduler.now, stamp - first))
            robot, _, name = topic.strip("/").rpartition("/")
            with suppress(ValueError, TypeError, KeyError, ConfigError):  # from a stranger
                message: Any = reader.message(topic, data)
                if name == EVENTS_TOPIC:
                    robots.feed(robot, read_json(message.data, MAX_MESSAGE_SIZE))
                elif name == MODEL_TOPIC:
                    judge.on_model(robot, read_json(message.data, MAX_MESSAGE_SIZE))
                elif robots.epoch is not None:
                    last = max(map(robots.last_end, robots.robots))
                    robots.enter(last, partial(_give, judge, channels[topic], message))
    if not robots.robots:
        raise ConfigError(f"has no events of robots (topics /<robot>/{EVENTS_TOPIC})", file=str(path))
    if robots.foreign:
        raise ConfigError("; ".join(robots.foreign.values()), file=str(path))
    robots.close()
    judge.end(complete=not robots.state.runs)
    return judge.judgements


def _give(judge: LiveJudge, channel: int, message: Any, time: int) -> None:
    judge.message(channel, time, message)
