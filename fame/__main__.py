"""``python -m fame``: the `fame` command."""

from __future__ import annotations

import sys

from fame.cli import main

sys.exit(main())
