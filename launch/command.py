#!/usr/bin/env python3
"""``ros2 run fame COMMAND ...`` is ``fame COMMAND --middleware ros ...``. Installed under the name of each command."""

import sys
from pathlib import Path

from fame.cli import main

arguments = [Path(sys.argv[0]).name, *sys.argv[1:]]
if arguments[0] not in ("log", "monitor"):
    arguments[1:1] = ["--middleware", "ros"]
elif arguments[1:2] in (["record"], ["process"]):  # the only parts of them that talk to robots
    arguments[2:2] = ["--middleware", "ros"]
sys.exit(main(arguments))
