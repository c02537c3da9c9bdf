"""The three modes as units of a mission: ``adm_collect``, ``adm_learn``, ``adm_operate``.

Each is made from variables, which the data object of its call activity names (models/monitoring). Topics, rules and
fields are as of `fame adm`; files are relative to the folder of the mission's model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from fame.errors import ConfigError, MissionError
from fame.robot.services import Around, Command, Unit, setting

if TYPE_CHECKING:
    from fame.monitor.anomaly.live import Rule

RULES, FIELDS = ("home", "signal", "count"), ("position", "velocity", "effort")


class CollectUnit:
    """Records runs with a label: ends after `runs` of them, else when its scope does; writes `output` either way."""

    def __init__(self, around: Around, variables: Mapping[str, Any]) -> None:
        from fame.monitor.anomaly.collect import Collect, Collector

        self._output = around.folder / setting(variables, "output", type=str)
        label = setting(variables, "label", type=int)
        if label not in (1, -1):
            raise ConfigError(f"found label = {label}; 1 (benign) or -1 (anomalous) would be right")
        points, runs = setting(variables, "points", 0, type=int), setting(variables, "runs", 0, type=int)
        self._collector = Collector(label, _rule(variables), cycle=points, limit=runs)
        self._report = around.report
        self._node = Collect(
            around.middleware, around.scheduler, self._collector,
            topic=setting(variables, "topic", "/joint_states", type=str), field=_choice(variables, "field", FIELDS),
            namespace=around.namespace, report=around.report, done=around.changed,
        )  # fmt: skip

    def results(self) -> Mapping[str, Any] | None:
        """`runs_collected`, once there are enough."""
        return {"runs_collected": self._collector.complete} if self._collector.done else None

    def close(self) -> None:
        """Leave, and write what has come."""
        from fame.monitor.anomaly.files import write_csv

        self._node.close()
        try:
            recording = self._collector.recording()
            for note in recording.notes:
                self._report(note)
            write_csv(self._output, recording)
        except MissionError as error:
            self._report(error.text)


class OperateUnit:
    """Watches runs and raises the signal `anomaly`, until its scope ends."""

    def __init__(self, around: Around, variables: Mapping[str, Any]) -> None:
        from fame.monitor.anomaly.operate import Operate
        from fame.monitor.anomaly.storage import load_model

        threshold = setting(variables, "threshold", type=float) if variables.get("threshold") is not None else None
        if threshold is not None and not 0 <= threshold < 1:
            raise ConfigError(f"found threshold = {threshold:g}; a number from 0 to 1 would be right")
        model = load_model(around.folder / setting(variables, "model", type=str))
        self._node = Operate(
            around.middleware, around.scheduler, model, threshold=threshold, rule=_rule(variables),
            cycle=setting(variables, "points", 0, type=int),
            topic=setting(variables, "topic", "/joint_states", type=str), field=_choice(variables, "field", FIELDS),
            namespace=around.namespace, report=around.report,
        )  # fmt: skip

    def results(self) -> Mapping[str, Any] | None:
        """It never ends by itself."""
        return None

    def close(self) -> None:
        """Leave; the run that goes on is judged as far as it got."""
        self._node.close()


def learn_unit(around: Around, variables: Mapping[str, Any]) -> Unit:
    """Fits the classifiers of `config` and stores the best in `model`: `classifier` is the name of the best one."""
    config = around.folder / setting(variables, "config", type=str)
    model = around.folder / setting(variables, "model", "best.skops", type=str)

    def results(told: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"classifier": next(item["name"] for item in told["classifiers"] if item["best"])}

    return Command(around, ["adm", "learn", str(config), "-o", str(model)], results)


def _rule(variables: Mapping[str, Any]) -> Rule:
    return cast("Rule", _choice(variables, "rule", RULES))


def _choice(variables: Mapping[str, Any], name: str, known: tuple[str, ...]) -> str:
    """One of the `known` words; the first if the variable is not set."""
    value = setting(variables, name, known[0], type=str)
    if value not in known:
        raise ConfigError(f"found {name} = {value!r}; {', '.join(known)} would be right")
    return value
