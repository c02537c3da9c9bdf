"""Scripts and conditions in JavaScript, with the interface of the original FaMe toolchain.

=============  ================================================================================
source         scripts as they are in the file, their errors, the engine (quickjs-ng) and its limits
interface.js   the names that scripts find, and how they are run
values         values as JSON texts
environment    variables of the process: sent when they change, read back when they were written; runs of scripts
realm          one context: the scripts of one process instance
commands       commands of scripts to their robot, and what scripts may use of their host
=============  ================================================================================
"""

from __future__ import annotations

import builtins
from collections.abc import Callable
from functools import partial
from typing import Any

from fame.bpmn.model import Expression
from fame.engine.data import BUILTINS, Variables
from fame.scripting.javascript.commands import REALM, HostApi
from fame.scripting.javascript.realm import Realm
from fame.scripting.javascript.source import JavaScriptError, SourceText, read_script
from fame.scripting.languages import HOST_API

__all__ = ["HostApi", "JavaScriptError", "compile_javascript"]


def compile_javascript(
    expression: Expression, *, script: bool, file: str = "", element: str = ""
) -> Callable[[dict[str, Any]], Any]:
    """Return a callable of the variables: a script gives None or a suspended script, an expression its value.

    Raises ModelError (file, line, element) if the text is not JavaScript, UnavailableError if its engine is not
    installed. The callable raises BpmnError for errors with a code, else JavaScriptError, or MessageError.
    """
    return partial(_run if script else _evaluate, read_script(expression, script=script, file=file, element=element))


def _run(script: SourceText, variables: dict[str, Any]) -> Any:
    return realm_of(variables).run(script, variables)


def _evaluate(script: SourceText, variables: dict[str, Any]) -> Any:
    return realm_of(variables).evaluate(script, variables)


def realm_of(variables: dict[str, Any]) -> Realm:
    """Return the realm of the scripts with these variables, created at its first use and kept in their interface."""
    names = variables.get(BUILTINS)
    if names.__class__ is dict and REALM in names:
        return names[REALM]  # type: ignore[no-any-return]
    if names.__class__ is not dict or names is vars(builtins):
        names = variables[BUILTINS] = dict(vars(builtins))
    while isinstance(variables, Variables):
        variables = variables.outer
    names[REALM] = Realm(variables, names[HOST_API]() if HOST_API in names else None)
    return names[REALM]  # type: ignore[no-any-return]
