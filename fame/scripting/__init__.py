"""Languages of scripts, conditions and values: compile the texts of a model to functions of the variables.

================  =======================================================================
compile_script    statements; returns None, or a suspended script if it has to wait
compile_expression  conditions and values
interface         the script interface: the ``__builtins__`` of the variables
Runner            runs suspended scripts
script_topics     the topics that a script names, for endpoints created at load
script_names      the variables that a text reads and writes, for checks
code_names        the functions, classes and modules that a script leaves for later ones, for checks
================  =======================================================================
"""

from fame.engine.data import UNDEFINED, Variables, plain
from fame.engine.host import BpmnError, Cancelled
from fame.scripting.analysis import ScriptTopic, code_names, script_names, script_topics
from fame.scripting.budget import BudgetExceeded, heartbeat
from fame.scripting.interface import NAMES, Log, Robot, another, interface, mission_date
from fame.scripting.languages import compile_expression, compile_script
from fame.scripting.python import error_line, error_text
from fame.scripting.requests import Call, Inbox, MessageQueue, Receive, Request, Sleep, Until
from fame.scripting.runner import GRACE, Runner

__all__ = [
    "GRACE", "NAMES", "UNDEFINED", "BpmnError", "BudgetExceeded", "Call", "Cancelled", "Inbox", "Log",
    "MessageQueue", "Receive", "Request", "Robot", "Runner", "ScriptTopic", "Sleep", "Until", "Variables",
    "another", "code_names", "compile_expression", "compile_script", "error_line", "error_text", "heartbeat",
    "interface", "mission_date", "plain", "script_names", "script_topics",
]  # fmt: skip
