"""Languages of scripts, conditions and values: compile the texts of a model to functions of the variables.

================  =======================================================================
compile_script    statements; returns None, or a suspended script if it has to wait
compile_expression  conditions and values
interface         the module of the script interface: the ``__builtins__`` of the variables
Runner            runs suspended scripts
script_topics     the topics that a script names, for endpoints created at load
script_names      the variables that a text reads and writes, for checks
imported_modules  the modules that a text imports
code_names        the functions, classes and modules that a script leaves for later ones, for checks
================  =======================================================================
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.scripting.analysis import (
        ScriptTopic as ScriptTopic,
        code_names as code_names,
        imported_modules as imported_modules,
        script_names as script_names,
        script_topics as script_topics,
    )
    from fame.scripting.budget import BudgetExceeded as BudgetExceeded, heartbeat as heartbeat
    from fame.scripting.interface import (
        NAMES as NAMES,
        Log as Log,
        Robot as Robot,
        another as another,
        mission_date as mission_date,
    )
    from fame.scripting.languages import compile_expression as compile_expression, compile_script as compile_script
    from fame.scripting.python import error_line as error_line, error_text as error_text
    from fame.scripting.requests import (
        Call as Call,
        Inbox as Inbox,
        MessageQueue as MessageQueue,
        Receive as Receive,
        ScriptRequest as ScriptRequest,
        Sleep as Sleep,
        Until as Until,
    )
    from fame.scripting.runner import GRACE as GRACE, Runner as Runner
else:
    __getattr__, __dir__, __all__ = attach(__name__)
