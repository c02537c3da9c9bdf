"""Which command a YAML file is for, told from its keys: what to say of a file that another command was given."""

from __future__ import annotations

from collections.abc import Mapping

_KINDS = {
    "scenario": ({"model"}, "a scenario", "fame run"),
    "world": ({"robots", "size", "bounds"}, "a world", "fame world"),
    "node": ({"Inputs", "Outputs"}, "the configuration of a node", "fame process, fame record or fame train"),
    "learning": ({"Files"}, "a learning file", "fame adm learn"),
}
"""The keys that only such a file has, what it is called, and its commands."""


def meant_for(content: object, kind: str) -> str:
    """What a file is, and its command, if it has the keys of another kind than `kind` and none of that; else empty.

    >>> meant_for({"Files": {}}, "node")
    'is a learning file, which is for fame adm learn'
    >>> meant_for({"Inputs": {}, "Files": {}}, "node"), meant_for({"speed": 1}, "world"), meant_for(None, "world")
    ('', '', '')
    """
    keys = {key for key in content if isinstance(key, str)} if isinstance(content, Mapping) else set()
    if not keys & _KINDS[kind][0]:
        for telling, name, commands in _KINDS.values():
            if keys & telling:
                return f"is {name}, which is for {commands}"
    return ""
