"""A robot of a team in many processes is taken over, steered and given back over DDS."""

import math
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from domains import PROCESSES
from middleware_contract import needs
from view_page import eventually

from fame.clock import SECOND
from fame.errors import FameError
from fame.scenario.process import scheduler_for
from fame.view import TeamView

ROOT = Path(__file__).parents[1]
pytestmark = [needs("cyclonedds"), pytest.mark.dds, pytest.mark.processes]


def test_a_car_in_another_process_is_steered_and_goes_on_with_its_mission() -> None:
    from fame.middleware.dds import DdsMiddleware

    environment = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES)}
    words = ("run", "examples/ground_vehicles.yaml", "--middleware", "dds", "--duration", "300", "--quiet")
    team = subprocess.Popen([sys.executable, "-m", "fame", *words], cwd=ROOT, env=environment)
    scheduler = scheduler_for("dds")
    middleware = DdsMiddleware(scheduler, domain=PROCESSES)
    view, places = TeamView(middleware, scheduler, control=True), list[tuple[float, float]]()

    def on_odometry(message: Any) -> None:
        places.append((message.pose.pose.position.x, message.pose.pose.position.y))

    middleware.node("_odometry").subscription("/REX/odom", "nav_msgs/msg/Odometry", on_odometry)
    thread = threading.Thread(target=lambda: scheduler.run(scheduler.now + 300 * SECOND))
    thread.start()
    asked = {"robot": "REX", "lease": "1", "who": "ann"}

    def taken_over() -> bool:
        """Whether REX is there and has been taken over: on a busy machine neither comes at once."""
        try:
            return view.control({"do": "take_over", **asked})["steers"]
        except FameError:
            return False

    def backwards() -> bool:
        view.control({"do": "take_over", **asked})
        for _ in range(5):
            view.control({"do": "steer", **asked, "speed": -0.4, "turn": 0})
            threading.Event().wait(0.1)
        return math.dist(places[0], places[-1]) > 0.3

    try:
        eventually(lambda: bool(places) and taken_over())
        places[:-1] = []
        eventually(backwards)
        view.control({"do": "continue", **asked})
        places[:-1] = []
        eventually(lambda: math.dist(places[0], places[-1]) > 0.3)
    finally:
        scheduler.stop()
        thread.join(30)
        view.close()
        middleware.close()
        team.terminate()
        team.wait(30)
