"""Languages of scripts, conditions and values: compile the texts of a model to functions of the variables.

================  =======================================================================
compile_script    statements; returns None, or a suspended script if it has to wait
compile_expression  conditions and values
interface         the module of the script interface: the ``__builtins__`` of the variables
Runner            runs suspended scripts
effects_of        what a text reads, sets, changes, publishes, calls, imports, raises, without running it
================  =======================================================================
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.scripting.budget import BudgetExceeded as BudgetExceeded, heartbeat as heartbeat
    from fame.scripting.effects import (
        Effects as Effects,
        ScriptTopic as ScriptTopic,
        effects_of as effects_of,
        script_effects as script_effects,
    )
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
