"""The 2D physics world: bodies, obstacles, targets, their map, and drawings of a run.

`sim2d.world.World` is built from a checked `sim2d.config.WorldConfig` and run by the scheduler.
`sim2d.scene` describes it in recordings, `sim2d.record` reads these, and `sim2d.animation` draws films and pictures of
them. The robots themselves are in the package `robots`.
"""

from fame.imports import attach

__getattr__, __dir__, __all__ = attach(__name__)
