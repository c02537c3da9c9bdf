"""The variables of scripts in JavaScript, and the runs that use them.

An `Environment` is a dict of variables with a copy in JavaScript: before each step only the changes are sent.

Numbers and texts are sent when the dict holds another object; what may change in place when its JSON text differs, and
only if some script of the realm names it. What has no JSON text (any more) is deleted in JavaScript. JavaScript parses
the text of a collection when a script reads it. After the step, JavaScript returns what it has written. Functions and
handles of JavaScript (such as a subscription that one script creates and another destroys) are kept in the dict as they
are, for its scripts only.

Invariant: between steps, `_known` equals the dict, in the same order, unless the dict was changed from outside.
"""

from __future__ import annotations

import marshal
from collections.abc import Callable, Sequence
from operator import is_
from types import ModuleType
from typing import TYPE_CHECKING, Any

from fame.engine.data import Variables
from fame.scripting.javascript.source import SourceText
from fame.scripting.javascript.values import ATOMS, encode
from fame.scripting.requests import MessageQueue, Next

if TYPE_CHECKING:
    from fame.scripting.javascript.realm import Realm

_NEW = object()
_CHANGING = frozenset({list, dict})
_NOTHING: dict[str, Any] = {}


class Environment:
    """One dict of variables.

    shown    the JavaScript object that scripts see
    runs     number of runs that may still write to it
    lasting  whether it is the dict of a process instance
    """

    __slots__ = ("_known", "_texts", "_watched", "lasting", "runs", "shown", "variables")

    def __init__(self, variables: dict[str, Any], shown: Any) -> None:
        self.variables: dict[str, Any] = variables
        self.shown: Any = shown
        self.runs: int = 0
        self.lasting: bool = type(variables) is dict
        self._known: dict[str, Any] = {}
        self._texts: dict[str, str] = {}  # of all collections that were sent
        self._watched: dict[str, bytes | None] = {}  # what may change in place, with its last `_mark`

    def changes(self, realm: Realm) -> tuple[str | None, Sequence[str]]:
        """Return the changes to send, as text, and the names of objects of JavaScript, which cannot be sent as text."""
        view = self.variables if self.lasting else _chained(self.variables)
        known = self._known
        if len(known) == len(view) and all(map(is_, known.values(), view.values())) and [*known] == [*view]:
            collections, lost = self._collections(view) if self._watched else (_NOTHING, [])
            return (encode([{}, collections, lost]) if collections or lost else None), ()
        values, kept = self._compare(view, realm)
        gone = [name for name in known if name not in view]
        self._known = dict(view)
        for name in (*gone, *values, *kept):
            self._texts.pop(name, None)
            self._watched.pop(name, None)
        collections, lost = self._collections(view)
        return encode([values, collections, gone + lost]), kept

    def _compare(self, view: dict[str, Any], realm: Realm) -> tuple[dict[str, Any], list[str]]:
        """New numbers and texts, and the names of new objects of JavaScript."""
        values: dict[str, Any] = {}
        kept: list[str] = []
        known = self._known
        for name, value in view.items():
            if known.get(name, _NEW) is value or name[:2] == "__":
                continue
            if value.__class__ in ATOMS:
                values[name] = value
            elif is_native(value):
                kept.append(name)
            elif realm.computed or name in realm.names:
                self._texts[name] = ""  # of another object, or none
                self._watched[name] = None
        return values, kept

    def _collections(self, view: dict[str, Any]) -> tuple[dict[str, str], list[str]]:
        """The texts of collections that have changed, and the names of those that have no text any more."""
        texts = self._texts
        found: dict[str, str] = {}
        lost: list[str] = []
        for name, mark in [*self._watched.items()]:
            value = view[name]
            now = _mark(value)
            if now is not None and now == mark:
                continue
            self._watched[name], text = now, _text(value)
            if text is None:
                lost += [name] if texts.pop(name, None) is not None else []
            elif texts.get(name) != text:
                texts[name] = found[name] = text
        return found, lost

    def resend(self) -> None:
        """Send again what no script has named before, since a new script may name it."""
        self._known = {
            name: value for name, value in self._known.items() if value.__class__ in ATOMS or name in self._texts
        }

    def apply(self, reply: dict[str, Any], kept: Callable[[Any, str], Any]) -> None:
        """Apply what JavaScript has written and deleted; `kept` gets its objects. Raises TypeError for a bad name."""
        for name, value in reply.get("set", _NOTHING).items():
            self._write(name, value)
        if "kept" in reply:
            for name in reply["kept"]:
                self._write(name, kept(self.shown, name))
        if "gone" in reply:
            for name in reply["gone"]:
                self._delete(name)

    def _write(self, name: str, value: Any) -> None:
        if name[:2] == "__":
            raise TypeError(f"{name} cannot be the name of a variable")
        self.variables[name] = self._known[name] = value
        if value.__class__ in _CHANGING:
            self._texts[name] = encode(value)
            self._watched[name] = _mark(value)
        elif name in self._watched or name in self._texts:
            self._texts.pop(name, None)
            self._watched.pop(name, None)

    def _delete(self, name: str) -> None:
        if name[:2] != "__" and name in self.variables:
            del self.variables[name]
        for known in (self._known, self._texts, self._watched):
            known.pop(name, None)

    def forget(self) -> None:
        """Remove all objects of JavaScript from the dict."""
        for name, value in list(self.variables.items()):
            if is_native(value):
                del self.variables[name]


def is_native(value: Any) -> bool:
    """Return whether a value is an object of JavaScript."""
    return type(value).__module__ == "_quickjs"


def _mark(value: Any) -> bytes | None:
    """A fingerprint that is much cheaper than the JSON text; None for what cannot have one."""
    try:
        return marshal.dumps(value, 2)
    except ValueError:
        return None


def _text(value: Any) -> str | None:
    """The JSON text of a collection; None for what cannot be serialised."""
    if callable(value) or isinstance(value, ModuleType):
        return None
    try:
        return encode(value)
    except (TypeError, ValueError, RecursionError):
        return None


def _chained(variables: dict[str, Any]) -> dict[str, Any]:
    """All variables that an inner scope sees."""
    if isinstance(variables, Variables):
        return {**_chained(variables.outer), **variables}
    return variables


# ---- runs ------------------------------------------------------------------------------------------------------------


class ScriptRun:
    """The state of one run.

    suspended  what the engine waits for, None if it does not wait
    callbacks  the numbers of callbacks that may come
    entrusted  whether it has put functions into variables, so that other scripts may call next()
    rejection  why one of its promises was rejected, empty if none was
    """

    __slots__ = ("callbacks", "entrusted", "environment", "number", "rejection", "script", "suspended")

    number: int
    script: SourceText
    environment: Environment

    def __init__(self, number: int, script: SourceText, environment: Environment) -> None:
        self.number, self.script, self.environment = number, script, environment
        self.callbacks: dict[int, None] = {}
        self.suspended: Suspended | None = None
        self.entrusted: bool = False
        self.rejection: str = ""


class _EndOfScript(MessageQueue):
    """A queue for the one message that the script is over."""

    __slots__ = ()

    def __str__(self) -> str:
        return "a callback to call next()"


class Suspended:
    """A script that has returned without calling next(): `fame.scripting.runner` drives it like a coroutine.

    It awaits a single message, which comes when next() is called. `cancel` ends the run with all its callbacks.
    """

    __slots__ = ("_cancel", "_queue", "_requested")

    def __init__(self, cancel: Callable[[], object]) -> None:
        self._cancel, self._requested = cancel, False
        self._queue = _EndOfScript("next", 1)

    def end(self, error: BaseException | None) -> None:
        """Resume the script: next() was called, or something failed."""
        self._queue.put((error,))

    def send(self, value: Any) -> Next:
        """Run one step, like the method of a coroutine."""
        if not self._requested:
            self._requested = True
            return Next(self._queue)
        (error,) = value
        if error is not None:
            raise error
        raise StopIteration

    def throw(self, error: BaseException) -> Next:
        """Cancel the run and raise the error, like the method of a coroutine."""
        self._cancel()
        raise error

    def close(self) -> None:
        """Cancel the run."""
        self._cancel()
