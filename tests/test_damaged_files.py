"""Files that somebody damaged: whatever happens to one, it is read, or refused in one line; never anything else."""

import copy
from random import Random

import pytest
from gallery import gallery
from lxml import etree

from fame.bpmn import extract_process, read_bytes, topic_table
from fame.bpmn.draw.diagram import draw
from fame.errors import ModelError

VALUES = [
    "",
    "gone",
    "-1",
    "true",
    "${x",
    "=",
    "${a}${b}",
    "1e400",
    "nan",
    "ü",
    "a:b:c",
    "<",
    "\u200b",
    "Signal_1",
    "P",
]


def damage(root: etree._Element, random: Random) -> None:
    """Changes one thing of a file."""
    elements = list(root.iter("*"))
    one, other = random.choice(elements), random.choice(elements)
    attribute = random.choice(list(one.attrib)) if one.attrib else "id"
    kind = random.randrange(6)
    if kind == 0 and one.getparent() is not None:
        one.getparent().remove(one)  # type: ignore[union-attr]
    elif kind == 1:
        one.attrib.pop(attribute, None)
    elif kind == 2:
        one.set(attribute, random.choice(VALUES))
    elif kind == 3:
        one.text = random.choice(VALUES)
    elif kind == 4:
        other.append(copy.deepcopy(one))
    else:
        one.tag = other.tag


@pytest.mark.long_but("*-12")
@pytest.mark.parametrize(("seed", "runs"), [(1, 12), *((seed, 60) for seed in range(5))])
def test_a_damaged_file_is_read_or_refused_in_one_line(seed: int, runs: int) -> None:
    random, source = Random(seed), gallery().encode()
    refusals = []
    for _ in range(runs):
        root = etree.fromstring(source)
        for _ in range(random.choice([1, 1, 3])):
            damage(root, random)
        refusals += handle(etree.tostring(root))
    assert 0 < len(refusals) < runs
    assert all(text.startswith("damaged.bpmn") and "\n" not in text for text in refusals)


def handle(source: bytes) -> list[str]:
    """Does all that can be done with a file, but for running it. Returns why it was refused, if it was."""
    faults: list[str] = []
    try:
        definitions = read_bytes(source, file="damaged.bpmn")
        faults = [f"damaged.bpmn: {one.text}" for process in definitions.processes for one in process.faults[:1]]
        topic_table(definitions)
        draw(definitions)
        parts = [extract_process(definitions, process.id) for process in definitions.processes]
    except ModelError as error:
        return [str(error)]
    for part in parts:
        read_bytes(part)
    return faults
