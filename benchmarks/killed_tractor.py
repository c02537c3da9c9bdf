"""Kill a tractor's engine in mid-mission over DDS, start it again, and draw what each robot did.

    python benchmarks/killed_tractor.py docs/images/killed_tractor.svg

The field is that of `tests/test_agriculture_processes.py`: a drone, two tractors, two weeds, in lockstep.
"""

from __future__ import annotations

import sys
import tempfile
from itertools import groupby
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from test_agriculture_processes import ROBOTS, Farm

COLOURS = {"running": "#4c78a8", "idle": "#d9d9d9", "dead": "#e45756"}


def play(farm: Farm, folder: Path) -> tuple[list[tuple[float, str, str]], dict[str, float]]:
    """Play the mission. Returns (time, robot, state) of all changes, and the moments of the kill and the return."""
    seen: list[tuple[float, str, str]] = []
    moments: dict[str, float] = {}

    def look() -> bool:
        for robot in ROBOTS:
            state = farm.last(robot).state if farm.last(robot) is not None else ""
            away = "killed" in moments and "back" not in moments and robot == moments_robot
            seen.append((farm.world["time"], robot, "dead" if away else "running" if state == "running" else "idle"))
        return all(farm.last(robot).state == "idle" for robot in ROBOTS)

    farm.begin(folder)
    farm.until(lambda: look() or farm.busy("Event_GoTo_Odometry"), "a tractor to be on its way")
    moments_robot = farm.busy("Event_GoTo_Odometry")
    farm.kill(farm.process(moments_robot))
    moments["killed"] = farm.world["time"]
    heard = len(farm.said[moments_robot])
    farm.begin_engine(moments_robot)

    def back() -> bool:
        look()
        return any(report.state == "running" for report in farm.said[moments_robot][heard:])

    farm.until(back, "the engine to be back")
    moments["back"] = farm.world["time"]
    farm.until(look, "the mission to be over")
    return seen, moments


def draw(seen: list[tuple[float, str, str]], moments: dict[str, float], weeds: dict[str, Any], path: Path) -> None:
    """A bar for each robot: when its mission ran, and when its engine was dead; a mark for each weed that was cut."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "fame"
    from matplotlib import pyplot
    from matplotlib.patches import Patch

    figure, axes = pyplot.subplots(figsize=(8, 2.4), layout="constrained")
    for row, robot in enumerate(ROBOTS):
        changes = [(time, state) for time, name, state in seen if name == robot]
        spans = [(state, list(group)) for state, group in groupby(changes, key=lambda change: change[1])]
        ends = [group[0][0] for _, group in spans[1:]] + [changes[-1][0]]
        for (state, group), end in zip(spans, ends, strict=True):
            axes.barh(row, end - group[0][0], left=group[0][0], height=0.6, color=COLOURS[state], linewidth=0)
    for weed in weeds.values():
        row = ROBOTS.index(weed["by"])
        axes.plot(weed["cut"], row, marker="X", color="black", markersize=8, linestyle="none")
    axes.axvline(moments["killed"], color=COLOURS["dead"], linewidth=1)
    axes.text(moments["killed"] + 0.5, len(ROBOTS) - 0.55, "kill -9", color=COLOURS["dead"], fontsize=8, va="bottom")
    axes.set_yticks(range(len(ROBOTS)), ROBOTS)
    axes.invert_yaxis()
    axes.set_xlabel("time of the mission (s)")
    labels = {"running": "mission runs", "idle": "waits for work", "dead": "engine dead, or starting"}
    marks = [Patch(color=COLOURS[state], label=label) for state, label in labels.items()]
    marks.append(axes.plot([], [], marker="X", color="black", linestyle="none", label="weed cut")[0])
    axes.legend(handles=marks, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, fontsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Play the mission and draw it."""
    farm = Farm()
    try:
        with tempfile.TemporaryDirectory() as folder:
            seen, moments = play(farm, Path(folder))
            weeds = farm.world["weeds"]
    finally:
        farm.close()
    draw(seen, moments, weeds, Path(sys.argv[1]))
    print(moments, {name: weed["cut"] for name, weed in weeds.items()})


if __name__ == "__main__":
    main()
