"""Processors and sources of others as their text shows them: a check runs no code of theirs.

What the text does not say for sure is not known, and nothing is refused for it: a base class, a decorator, a parameter
with a computed limit.
"""

from __future__ import annotations

import ast
import inspect
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib.machinery import PathFinder
from importlib.util import find_spec
from os.path import isfile
from pathlib import Path
from typing import Any, ClassVar, TypeGuard

from fame.config.loader import find_object, split_name
from fame.errors import MODULE_NOT_FOUND, ConfigError
from fame.monitor.pipeline.processor import Parameter
from fame.robot.services import MissingFileError
from fame.scripting.python import name_of


class StandIn:
    """In place of a class of which only the text is known. Its signature says what it takes; without, it is not known.

    Raises TypeError for other arguments.
    """

    parameters: ClassVar[tuple[Parameter, ...]] = ()
    __signature__: ClassVar[inspect.Signature | None] = None

    def __init__(self, **values: Any) -> None:
        if self.__signature__ is not None:
            self.__signature__.bind(**values)

    def execute(self, inputs: Mapping[str, Any], /) -> None:
        """Compute nothing."""


def takes_any(kind: type) -> TypeGuard[type[StandIn]]:
    """Return whether it is not known which parameters a class takes."""
    return issubclass(kind, StandIn) and kind.__signature__ is None


def look_up(name: str, folder: Path) -> Any:
    """Return a stand-in for what ``module:Name`` or ``file.py:Name`` (relative to `folder`) names, without running it.

    Raises ConfigError for what `find_object` refuses for sure, MissingFileError for a module or file that is not here.
    """
    module, attribute = split_name(name)
    try:
        path = (folder / module).resolve() if module.endswith(".py") else _file_of(module)
        if path is not None and not isfile(path):
            raise MissingFileError(f"there is no file {path}")
        text = path.read_bytes() if path is not None else b""
        with warnings.catch_warnings():  # of Python about the text, which the run gives
            warnings.simplefilter("ignore")
            tree = ast.parse(text)
    except SyntaxError:
        return find_object(name, folder)  # which raises the same
    except (OSError, ValueError, RecursionError, MemoryError):
        return StandIn
    named = [node for node in ast.walk(tree) if attribute in _names(node)]
    shown = path is not None and not _DYNAMIC.search(text)
    if shown and not named:
        raise ConfigError(f"{module} has no {attribute!r}")
    match named:
        case [ast.FunctionDef(decorator_list=[]) | ast.AsyncFunctionDef(decorator_list=[])] if named[0] in tree.body:
            return lambda: None
        case [ast.ClassDef(decorator_list=[]) as found] if shown and found in tree.body:
            return _class(found, {*_set_attributes(found, "")} | {*_set_attributes(tree, "self")})
    return StandIn


_DYNAMIC = re.compile(rb"import\s*\(?\s*\*|__getattr__|__dict__|\b(?:globals|locals|vars|setattr|exec|eval)\b")
"""What may give names to a module or class that its text does not show."""


def _file_of(module: str) -> Path | None:
    """The file of a module, found without running its packages; None if it has none. Raises MissingFileError."""
    names, spec = module.split("."), None
    for count, name in enumerate(names, 1):
        inside = spec.submodule_search_locations if spec is not None else None
        spec = find_spec(name) if count == 1 else PathFinder.find_spec(".".join(names[:count]), inside or [])
        if spec is None:
            raise MissingFileError(f"Python does not find the module {module} here: {MODULE_NOT_FOUND}")
    return Path(spec.origin) if spec is not None and spec.origin and spec.origin.endswith(".py") else None


def _names(node: ast.AST) -> tuple[object, ...]:
    """The names that a node binds."""
    if isinstance(node, ast.Name):
        return () if isinstance(node.ctx, ast.Load) else (node.id,)
    return getattr(node, "name", None), getattr(node, "asname", None)


def _set_attributes(tree: ast.AST, but_of: str) -> Iterator[str]:
    """The attributes that are set, but for those of one name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and name_of(node.value) != but_of:
            yield node.attr


def _class(found: ast.ClassDef, set_later: set[str]) -> type:
    """A stand-in of a class, with what it certainly declares."""
    parts: dict[str, Any] = {}
    for statement in found.body:
        for target in (statement, *getattr(statement, "targets", ()), getattr(statement, "target", None)):
            for name in _names(target) if target is not None else ():
                parts[str(name)] = getattr(statement, "value", statement)
    bound = Counter(name for node in found.body for inner in ast.walk(node) for name in _names(inner))

    def known(name: str) -> bool:
        return name not in set_later and bound[name] == (name in parts)

    alone = not (found.bases or found.keywords)
    if alone and known("execute") and "execute" not in parts:
        return type(found.name, (), {})
    said: dict[str, Any] = {}
    items = [_parameter(item) for item in getattr(parts.get("parameters", _NO_ITEMS), "elts", [None])]
    if known("parameters"):
        said["parameters"] = tuple(item for item in items if item is not None)
        if alone and None not in items and known("__init__") and not bound["__new__"]:
            said["__signature__"] = _signature(parts.get("__init__"))
    if alone and known("outputs") and (outputs := _literal(parts.get("outputs"))):
        said["outputs"] = outputs
    return type(found.name, (StandIn,), said)


_NO_ITEMS = ast.Tuple([])


def _literal(node: ast.AST | None) -> Any:
    """The value of a literal; None of anything else."""
    try:
        return ast.literal_eval(node) if isinstance(node, ast.expr) else None
    except (ValueError, TypeError):
        return None


def _parameter(node: ast.AST | None) -> Parameter | None:
    """The parameter that an expression makes of literals; None of any other."""
    if not isinstance(node, ast.Call) or ast.unparse(node.func).rpartition(".")[2] != "Parameter":
        return None
    try:
        keywords = {str(each.arg): ast.literal_eval(each.value) for each in node.keywords}
        return Parameter(*map(ast.literal_eval, node.args), **keywords)
    except (ValueError, TypeError):
        return None


def _signature(init: Any) -> inspect.Signature:
    """The signature of a class with this ``__init__``, or without one; all defaults are None."""
    if not isinstance(init, ast.FunctionDef):
        return inspect.Signature()
    kind, given = inspect.Parameter, init.args
    positional = [*given.posonlyargs, *given.args][1:]
    free = [False] * (len(positional) - len(given.defaults)) + [True] * len(given.defaults)
    free += [default is not None for default in given.kw_defaults]
    taken = [
        kind(each.arg, kind.KEYWORD_ONLY, default=None if has else kind.empty)
        for each, has in zip([*positional, *given.kwonlyargs], free, strict=True)
    ]
    return inspect.Signature(taken + ([kind(given.kwarg.arg, kind.VAR_KEYWORD)] if given.kwarg is not None else []))
