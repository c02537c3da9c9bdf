#!/usr/bin/env python3
"""``ros2 run fame COMMAND ...`` is ``fame COMMAND --middleware ros ...``. Installed under the name of each command."""

import sys
from pathlib import Path

from fame.cli import main

sys.exit(main([Path(sys.argv[0]).name, "--middleware", "ros", *sys.argv[1:]]))
