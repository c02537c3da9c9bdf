"""DDS domains of this run of the tests: other runs may be on the machine, and other workers of pytest-xdist are."""

from __future__ import annotations

import os

_WORKER = os.environ.get("PYTEST_XDIST_WORKER")
_RUN = os.getpid() if _WORKER is None else os.getppid()
_OFFSET = _RUN % 12 * 8 + int((_WORKER or "gw0").removeprefix("gw")) % 4 * 2

DOMAIN = 1 + _OFFSET
"""The next domain belongs to this worker, too. Domains above 101 use ports that other programs may have."""
PROCESSES = 100 + _OFFSET
"""For engines in processes of their own; the next domain belongs to this worker, too."""
