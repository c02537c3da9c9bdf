"""The table of message types: ROS 2 Jazzy's common interfaces, a sourced ROS, registered types, and Nav2's interfaces.

The interfaces of Nav2 that missions use come with FAME (folder ``interfaces``, those of Jazzy). A sourced workspace
that has the package wins, because interfaces differ between the releases of Nav2.

There is one table for the process, as in ROS: it only grows, and a type in it never changes. It is read when the first
type is requested.

Importing rosbags and numpy and reading that table takes a third of the start-up of an engine, which needs them only for
its first process. So the few types that every engine needs at once are defined here: that of texts, in which processes
and statuses are sent, and the one that announces nodes (`fame.middleware.dds.discovery`).
"""

from __future__ import annotations

import difflib
import json
import os
import re
import threading
from collections.abc import Iterable, Mapping
from os.path import isdir, isfile
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fame.errors import MessageError
from fame.middleware.definitions import LONGEST, Definition, Field, Sizes, check_size, from_rosbags, from_text

STRING = "std_msgs/msg/String"
GID, NODE = "rmw_dds_common/msg/Gid", "rmw_dds_common/msg/NodeEntitiesInfo"
PARTICIPANT = "rmw_dds_common/msg/ParticipantEntitiesInfo"


def _definition(name: str, *fields: Field) -> Definition:
    return Definition(name, fields, MappingProxyType({}), MappingProxyType({}))


BUILTIN = {
    content.name: content
    for content in (
        _definition(STRING, Field("data", "data", "string", "single")),
        _definition(GID, Field("data", "data", "uint8", "array", 16)),
        _definition(
            NODE,
            Field("node_namespace", "node_namespace", "string", "single", bound=256),
            Field("node_name", "node_name", "string", "single", bound=256),
            Field("reader_gid_seq", "reader_gid_seq", GID, "sequence"),
            Field("writer_gid_seq", "writer_gid_seq", GID, "sequence"),
        ),
        _definition(
            PARTICIPANT,
            Field("gid", "gid", GID, "single"),
            Field("node_entities_info_seq", "node_entities_info_seq", NODE, "sequence"),
        ),
    )
}
"""The types that are known without rosbags and numpy. They equal those of rosbags."""
HASHES = {
    STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    PARTICIPANT: "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e",
}
"""As `fame.middleware.codec.type_hash` would compute them."""

_DEFAULTS: dict[str, dict[str, Any]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}
"""Type -> field -> default other than zero: all of those in the common interfaces."""

_SERVICES = {
    "action_msgs/srv/CancelGoal": "GoalInfo goal_info\n---\nint8 return_code\nGoalInfo[] goals_canceling",
    "lifecycle_msgs/srv/ChangeState": "Transition transition\n---\nbool success",
    "lifecycle_msgs/srv/GetAvailableStates": "---\nState[] available_states",
    "lifecycle_msgs/srv/GetAvailableTransitions": "---\nTransitionDescription[] available_transitions",
    "lifecycle_msgs/srv/GetState": "---\nState current_state",
    "std_srvs/srv/Empty": "---",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message",
    "tello_msgs/srv/TelloAction": "string cmd\n---\n"
    "uint8 OK=1\nuint8 ERROR_NOT_CONNECTED=2\nuint8 ERROR_BUSY=3\nuint8 rc",
}
"""Services of the standard, and that of the original FaMe's drone."""
_ROS_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_")
_SUFFIXES = (".msg", ".srv", ".action")
_SHIPPED = Path(__file__).with_name("interfaces")
_definitions: dict[str, Definition] = {}
_checked: Sizes = {}
"""The types whose references and sizes were checked."""
_broken: dict[str, str] = {}
"""Types whose files were left out, with the file and the reason."""
_lock = threading.RLock()


def definition(name: str) -> Definition:
    """Return the definition of ``pkg/msg/Type``; ``msg/`` may be left out. Raises MessageError
    that suggests similar names."""
    full = name.strip()
    if full.count("/") == 1:
        full = full.replace("/", "/msg/")
    if full in BUILTIN:
        return BUILTIN[full]
    known = _table()
    if full in known or _sourced(full):
        return known[full]
    if f"{full}_Request" in known:
        raise MessageError(f"this is a service; its messages are {full}_Request and {full}_Response", type=name)
    raise MessageError(f"there is no such message type{_broken_file(full) or _suggestion(name, known)}", type=name)


def names() -> list[str]:
    """Return the full names of all types, sorted."""
    return sorted(_table())


def service(name: str) -> tuple[str, str]:
    """Return the types of request and response of the service type ``pkg/srv/Name``; ``srv/`` may be left out.

    Raises MessageError for a service type that is unknown or contains an unknown type.
    """
    full = name.strip()
    if full.count("/") == 1:
        full = full.replace("/", "/srv/")
    request, response = f"{full}_Request", f"{full}_Response"
    if request not in _table() and not _sourced(request):
        services = [entry.removesuffix("_Request") for entry in names() if entry.endswith("_Request")]
        suggestion = _broken_file(full) or _suggestion(name, services)
        raise MessageError(f"there is no such service type{suggestion}", type=name)
    for full in (request, response):
        check_references(definition(full))
    return request, response


def action(name: str) -> str:
    """Return the full name of the action type ``pkg/action/Name``; ``action/`` may be left out. Raises MessageError."""
    full = name.strip()
    if full.count("/") == 1:
        full = full.replace("/", "/action/")
    if f"{full}_Goal" not in _table() and not _sourced(f"{full}_Goal"):
        actions = [entry.removesuffix("_Goal") for entry in names() if "/action/" in entry and entry.endswith("_Goal")]
        advice = f"{_suggestion(name, actions)}; register its .action file, or source its package"
        raise MessageError(f"there is no such action type{_broken_file(full) or advice}", type=name)
    return full


def dds_type(name: str) -> str:
    """Return the name of a type on the wire, over DDS and Zenoh.

    >>> dds_type("std_msgs/msg/String")
    'std_msgs::msg::dds_::String_'
    """
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def ros_type(name: str) -> str:
    """Return the inverse of `dds_type`; another name is returned as it is."""
    match = _ROS_TYPE.fullmatch(name)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else name


def register(text: str, name: str) -> list[str]:
    """Add the types of the text of a `.msg`, `.srv` or `.action` file (``pkg/msg/Type``, ``pkg/srv/Name`` ...).

    Returns their full names. The same text again does nothing. Types that it refers to may follow later. Raises
    MessageError for a text that cannot be read, and for a type that is there already but different.
    """
    return add(from_text(text, name))


class _Conflict(MessageError):
    """There is a type of this name already, with other content."""


def add(contents: Iterable[Definition]) -> list[str]:
    """Add types. Raises as `register`."""
    described = {content.name: content for content in contents}
    with _lock:
        known = _table()
        for full, content in described.items():
            if known.get(full, content) != content:
                text = "there is a type of this name already, with other content: give it another name"
                raise _Conflict(text, type=full)
        known.update(described)
    return list(described)


def register_files(path: str | Path, package: str = "") -> list[str]:
    """Add the types of a `.msg`, `.srv` or `.action` file, or of all such files in a directory and below.

    The package of a file is `package`, else the name of its directory, or of the one above if that is ``msg``, ``srv``
    or ``action``. Returns full names. Of a directory, a file that cannot be read, or has a field of an unknown type, is
    left out: an error that its type is unknown names the file. Raises MessageError for such a `path` itself, for one
    without such files, and for a type that is there already but different; then none is added.
    """
    root = Path(path).resolve()
    files = sorted(file for file in root.rglob("*") if file.suffix in _SUFFIXES) if isdir(root) else [root]
    if not files or not all(isfile(file) and file.suffix in _SUFFIXES for file in files):
        raise MessageError(f"there is no .msg, .srv or .action file at {path}")
    before, described, broken = dict(_table()), dict[str, list[str]](), dict[str, str]()
    places: dict[str, Path] = {}
    try:
        for file in files:
            home = file.parent.parent if f".{file.parent.name}" in _SUFFIXES else file.parent
            name = f"{package or home.name}/{file.suffix[1:]}/{file.stem}"
            places[name] = file
            try:
                if file.stat().st_size > LONGEST:
                    raise MessageError(f"has more than {LONGEST:,} bytes", type=name)
                described[name] = add(from_text(file.read_text("utf-8"), name))
            except _Conflict:
                raise
            except (MessageError, OSError, ValueError) as problem:
                broken[name] = str(problem)
        while wrong := {name: text for name, full in described.items() if (text := _missing_reference(full))}:
            for name in wrong:  # what refers to it is the next to go
                _forget(described.pop(name), before)
            broken |= wrong
        if broken and not root.is_dir():
            raise MessageError(f"{root}: {broken.popitem()[1]}")
    except MessageError:
        _forget(_definitions.keys(), before)
        raise
    _broken.update((name, f"{places[name]}: {text}") for name, text in broken.items())
    for name in described:
        _broken.pop(name, None)
    return [full for names in described.values() for full in names]


def _missing_reference(names: Iterable[str]) -> str:
    """Why one of these types cannot be used: it refers to an unknown type, or to itself; empty if all can."""
    try:
        for full in names:
            check_references(definition(full))
    except MessageError as error:
        return str(error)
    return ""


def _forget(names: Iterable[str], before: Mapping[str, Definition]) -> None:
    """Remove types again that were not there `before`."""
    with _lock:
        for full in [full for full in names if full not in before]:
            del _definitions[full]
            _checked.pop(full, None)


def check_references(content: Definition) -> None:
    """Raise MessageError if a field is of an unknown type, if a type contains itself, or if its messages would be too
    large."""
    if content.name not in _checked:
        check_size(content.name, _find, _checked)


def _find(name: str) -> Definition | None:
    return BUILTIN.get(name) or (_table()[name] if name in _table() or _sourced(name) else None)


def _sourced(full: str) -> bool:
    """Register a type of the sourced ROS workspace, or of the interfaces that come with FAME; False if neither has
    it. Raises MessageError for a file that cannot be read."""
    package, _, rest = full.partition("/")
    kind, _, name = rest.partition("/")
    name = name.partition("_")[0]
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    for prefix in (*prefixes, str(_SHIPPED)) if kind else ():
        file = Path(prefix, "share", package, kind, f"{name}.{kind}")
        if file.is_file():
            try:
                text = file.read_text("utf-8")
            except (OSError, ValueError) as error:
                raise MessageError(f"{file} cannot be read: {error}", type=full) from None
            return full in register(text, f"{package}/{kind}/{name}")
    return False


def broken_files() -> list[str]:
    """Return the files of folders that were left out, each with what is wrong with it."""
    return list(_broken.values())


def _broken_file(full: str) -> str:
    """``; its file cannot be used: ...`` if a file of this type, or of what it is a part of, was left out."""
    found = next((text for name, text in _broken.items() if full == name or full.startswith(f"{name}_")), "")
    return f"; its file cannot be used: {found}" if found else ""


def _suggestion(name: str, known: Iterable[str]) -> str:
    """``; did you mean ...?`` with similar names, or names with the same ending, if there are any; where to name the
    folder of a package that is unknown."""
    ending = name.strip().rpartition("/")[2].lower()
    known = sorted(known)
    similar = [full for full in known if full.rpartition("/")[2].lower() == ending]
    similar += [full for full in difflib.get_close_matches(name, known, cutoff=0.8) if full not in similar]
    if similar:
        return f"; did you mean {' or '.join(similar[:3])}?"
    package, is_full, _ = name.strip().partition("/")
    own = bool(is_full) and not any(full.startswith(f"{package}/") for full in known)
    where = f"; the folder that has {package} is named in fame.yaml, here or above (types: [FOLDER]), or by --types"
    return where if own else ""


def _table() -> dict[str, Definition]:
    """All definitions by full name, loaded now if this is the first time."""
    if not _definitions:
        with _lock:
            if not _definitions:
                _definitions.update(_of_jazzy())
    return _definitions


_JAZZY = Path(__file__).parent / "interfaces" / "jazzy.json"
"""The types of Jazzy as rosbags has them, which makes thousands of functions of six releases when it is asked."""


def _of_jazzy() -> dict[str, Definition]:
    messages = json.loads(_JAZZY.read_bytes()).items()
    definitions = [
        from_rosbags(name, constants, fields, _DEFAULTS.get(name, {})) for name, (constants, fields) in messages
    ]
    for name, text in _SERVICES.items():
        definitions += from_text(text, name)
    return {content.name: content for content in definitions}
