"""Read properties from YAML: the key ``properties`` of a scenario, or a file of its own beside a model."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from fame.bpmn.model import Definitions
from fame.config.loader import read_document
from fame.config.values import ConfigValue
from fame.errors import ConfigError
from fame.properties.grammar import parse
from fame.properties.sentence import Location, PoseTopic, Property

SUFFIX = ".properties.yaml"
KEYS = ("properties", "poses")
"""Of such a file."""


def read_properties(path: str | Path) -> tuple[Property, ...]:
    """Return the properties of a file with the key ``properties``. Raises ConfigError with file, line and column."""
    document = read_document(path)
    keys = document.mapping(KEYS)
    return properties_of(document.required("properties", "{NAME: SENTENCE}"), poses_of(keys.get("poses")))


def properties_of(value: ConfigValue, poses: tuple[PoseTopic, ...] = ()) -> tuple[Property, ...]:
    """Return the properties of a mapping from names to sentences.

    Raises ConfigError with file, line and column: the first one, and as its notes those of the other sentences.
    """
    found, errors = list[Property](), list[ConfigError]()
    for name, sentence in value.mapping().items():
        try:
            place = Location(value.source.file, sentence.line, sentence.column)
            found.append(replace(parse(sentence.text(), place, name), poses=poses))
        except ConfigError as error:
            errors.append(error)
    if errors:
        for other in errors[1:]:
            errors[0].add_note(str(other))
        raise errors[0]
    return tuple(found)


def poses_of(value: ConfigValue | None) -> tuple[PoseTopic, ...]:
    """Return the topics with positions, by robot or pool. Raises ConfigError for what is no topic."""
    found = list[PoseTopic]()
    for robot, topic in value.mapping().items() if value is not None else ():
        if not re.fullmatch(r"~?(/\w+)+", topic.text()):
            raise topic.expected("a topic, as in /map_pose, or ~/odom for the robot's own")
        found.append(PoseTopic(robot, topic.text(), Location(topic.source.file, topic.line)))
    return tuple(found)


def beside(model: Path) -> tuple[Property, ...]:
    """Return the properties of the file ``NAME.properties.yaml`` beside a model ``NAME.bpmn``, if there is one."""
    path = model.with_name(model.stem + SUFFIX)
    return read_properties(path) if path.is_file() else ()


def properties_and_model(path: Path) -> tuple[tuple[Property, ...], Definitions | None]:
    """Return the properties in a file of their own or a scenario, and the model that they are about, if that is there.

    Raises ConfigError for a file that has no properties, ModelError for a model that cannot be read.
    """
    from fame.bpmn.reader import read

    keys = read_document(path).mapping()
    if "properties" not in keys:
        raise ConfigError("expected the key properties: {NAME: SENTENCE}", file=str(path))
    named = path.parent / str(keys["model"].data) if "model" in keys else None
    model = named or path.with_name(path.name.removesuffix(SUFFIX) + ".bpmn")
    made = properties_of(keys["properties"], poses_of(keys.get("poses")))
    return made, read(model) if model.is_file() else None
