"""Load what missions need before the first test begins, so that a test takes the time that its mission takes.

The imports take ten times as long as a short mission. What is loaded stays: a garbage collection that looks through all
of it takes longer than a test, too, and would be added to any one of them.
"""

from __future__ import annotations

import gc


def preload() -> None:
    """Import what missions without a world use, and look for no garbage in all that exists from now on."""
    import numpy  # noqa: F401 (arrays in messages)
    import yaml  # noqa: F401 (scenarios, payloads)

    import fame.testing.mission  # noqa: F401
    from fame.middleware import typesystem

    typesystem.names()
    gc.collect()
    gc.freeze()
