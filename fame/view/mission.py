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
    return {
        "kind": kind,
        "title": title,
        "chips": list(chips),
        "notices": list(notices),
        "robots": [{"name": robot, "pool": pool_of(catalogue, robot)} for robot in robots],
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


def place_of(packer: Packer, robot: int, process: str) -> dict[str, int]:
    """Return the drawing and the pool of the process (id) that a robot runs."""
    catalogue, number = packer.catalogue, packer.element(robot, process)
    if number == NOWHERE:
        return {"plane": NOWHERE, "pool": NOWHERE}
    return {"plane": catalogue.plane_of(number), "pool": catalogue.pool_of(number)}


def pool_of(catalogue: Catalogue, robot: str) -> int:
    """Return the number of the pool that a robot plays."""
    for number, definitions in enumerate(catalogue.files[:1]):
        try:
            pools = pools_of(definitions)
        except FameError:
            return NOWHERE
        for pool in pools:
            if matches(robot, pool):
                found = next((one.id for one in definitions.participants if one.process == pool.process.id), "")
                return catalogue.number(number, found) if found else NOWHERE
    return NOWHERE
