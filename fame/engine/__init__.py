"""The interpreter of one robot's process. It has no I/O, no threads, no clock, no XML and no ROS.

`compile_program` compiles a process and all processes that it calls into a `Program`; an `Engine` holds its instances.
The engine calls a `Host`, its interface to the world, and receives stimuli in return (`Engine.start`, `deliver`,
`timer_fired`, `script_ended`, `complete_task`). Each stimulus runs to completion: every token moves until it waits.
Semantics are those of BPMN 2.0 chapter 13, with the additions of docs/semantics.md.

Observers receive (instance, scope, element, what, detail):

======  ==========================================================================
start   an instance of the process started
enter   a token came to an element
leave   the element has completed
take    a sequence flow was taken
cancel  the work at the element was cancelled
fail    the element failed; the detail is the error code
end     the instance ended; the detail is its status
======  ==========================================================================
"""

from fame.engine.compiler import compile_program as compile_program
from fame.engine.data import UNDEFINED as UNDEFINED, Variables as Variables, plain as plain
from fame.engine.host import BpmnError as BpmnError, Cancelled as Cancelled, Host as Host
from fame.engine.interpreter import MOVES as MOVES, Engine as Engine
from fame.engine.program import Program as Program
from fame.engine.scope_compiler import FindProcess as FindProcess
from fame.engine.snapshot import restore as restore, snapshot as snapshot
from fame.engine.state import DEPTH as DEPTH, Instance as Instance
