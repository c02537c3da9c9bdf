"""The page that shows a mission, live and recorded: diagrams with tokens, the world, a timeline, variables.

A `PageSource` gives a page what it shows; a `Server` serves the page on this machine. The page itself is in ``page/``:
plain ES modules and CSS, without a build step.

    server     the server and its address
    blocks     a run cut into blocks, which the page loads
    state      the state of a run at an instant
    catalogue  elements and drawings of the models
    mission    what a page receives first
    forms      forms of tasks and messages
    people     what a person with an address of their own may do
    sink       blocks of what would be recorded
    replay     the source of a recording; page_file: that as one file, with its page_content
    live       the source of a run in this process; control: commands of its page; steering: velocity commands
    team       the source of a team on the network
    watch      the source of a model while it is drawn
    change     the source of a model that a running team could change to
    heat       the source of all recordings of a folder, as colours on the models
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.view.control import RunControl as RunControl
    from fame.view.heat import HeatMap as HeatMap
    from fame.view.live import LiveRun as LiveRun, SameRun as SameRun
    from fame.view.replay import Replay as Replay
    from fame.view.server import PageSource as PageSource, Server as Server
    from fame.view.team import TeamView as TeamView
    from fame.view.watch import ModelWatch as ModelWatch
else:
    __getattr__, __dir__, __all__ = attach(__name__)
