"""The 2D physics world: bodies, obstacles, targets, their map, and drawings of a run.

`sim2d.world.World` is built from a checked `sim2d.config.WorldConfig` and run by the scheduler.
`sim2d.record.Recorder` watches it; `sim2d.picture` and `sim2d.animation` draw what was recorded. The robots
themselves are in the package `robots`.
"""
