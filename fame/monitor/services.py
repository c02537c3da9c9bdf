"""The units that come with FAME, by the name that a service task calls them: see models/monitoring."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fame.robot.services import Around, Make, Unit


def _adm_collect(around: Around, variables: Mapping[str, Any]) -> Unit:
    from fame.monitor.anomaly.units import CollectUnit

    return CollectUnit(around, variables)


def _adm_learn(around: Around, variables: Mapping[str, Any]) -> Unit:
    from fame.monitor.anomaly.units import learn_unit

    return learn_unit(around, variables)


def _adm_operate(around: Around, variables: Mapping[str, Any]) -> Unit:
    from fame.monitor.anomaly.units import OperateUnit

    return OperateUnit(around, variables)


def _processing(around: Around, variables: Mapping[str, Any]) -> Unit:
    from fame.monitor.pipeline.units import processing_unit

    return processing_unit(around, variables)


def _record(around: Around, variables: Mapping[str, Any]) -> Unit:
    from fame.monitor.pipeline.units import record_unit

    return record_unit(around, variables)


def _train(around: Around, variables: Mapping[str, Any]) -> Unit:
    from fame.monitor.pipeline.units import train_unit

    return train_unit(around, variables)


UNITS: Mapping[str, Make] = {
    "adm_collect": _adm_collect,
    "adm_learn": _adm_learn,
    "adm_operate": _adm_operate,
    "process": _processing,
    "record": _record,
    "train": _train,
}
"""What needs packages is imported when a unit is made."""

NEEDS: Mapping[str, tuple[str, ...]] = {
    "adm_collect": ("output", "label"),
    "adm_learn": ("config",),
    "adm_operate": ("model",),
    "process": ("configuration",),
    "record": ("configuration", "output"),
    "train": ("configuration",),
}
"""The variables that a unit cannot do without."""

GIVES: Mapping[str, tuple[str, ...]] = {
    "adm_collect": ("runs_collected",),
    "adm_learn": ("classifier",),
    "train": ("model", "thresholds"),
}
"""The variables that a unit sets when it ends; those that are not here set none."""
