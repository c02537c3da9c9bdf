"""What a page receives first: title, robots, elements, planes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from fame.bpmn.pools import matches, pools_of
from fame.errors import FameError
from fame.robot.wait_sentences import SENTENCES
from fame.view.catalogue import NOWHERE, Catalogue

if TYPE_CHECKING:
    from fame.view.blocks import Packer

Chip = tuple[str, str, str]
"""A short text in the heading, its class of style, and its explanation."""


def mission_json(
    kind: str,
    title: str,
    catalogue: Catalogue,
    robots: Iterable[str],
    *,
    chips: Sequence[Chip] = (),
    notices: Sequence[str] = (),
    **more: Any,
) -> dict[str, Any]:
    """Return what a page shows besides blocks. `kind`: ``recording``, ``live`` or ``model``;
    `more` is added as it is."""
    names = list(robots)
    return {
        "kind": kind,
        "title": title,
        "chips": list(chips),
        "notices": list(notices),
        "robots": [{"name": robot, **role_of(catalogue, robot)} for robot in names],
        "order": [*range(len(names))],
        "elements": catalogue.elements_json(),
        "planes": catalogue.planes_json(),
        "types": catalogue.types_json(),
        "models": [file.file for file in catalogue.files],
        "sentences": SENTENCES,
        "reading": 1,
        "blocks": [],
        "end": 0,
        "control": [],
        "messages": False,
        **more,
    }


def place_of(packer: Packer, robot: int, process: str) -> dict[str, Any]:
    """Return the drawing, the pool and the start events of the process (id) that a robot runs."""
    catalogue, number = packer.catalogue, packer.element(robot, process)
    if number == NOWHERE:
        return {"plane": NOWHERE, "pool": NOWHERE, "starts": []}
    pool, starts = catalogue.pool_of(number), catalogue.starts_of(number)
    return {"plane": catalogue.plane_of(number), "pool": pool, "starts": starts}


def role_of(catalogue: Catalogue, robot: str) -> dict[str, Any]:
    """Return the pool that a robot plays, and its start events, by number."""
    for number, definitions in enumerate(catalogue.files[:1]):
        try:
            pools = pools_of(definitions)
        except FameError:
            break
        for pool in pools:
            if matches(robot, pool):
                process = catalogue.number(number, pool.process.id)
                return {"pool": catalogue.pool_of(process), "starts": catalogue.starts_of(process)}
    return {"pool": NOWHERE, "starts": []}
