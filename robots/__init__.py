"""The robots that come with FAME: what each publishes and obeys, and how it moves.

Each type is a class with the members of `sim2d.robot.SimulatedRobot`; `sim2d.registry` finds it by the `type:` of a
world file.

    vehicles   car and tractor; drive, odometer and planner are theirs
    drone      a quadrotor; flight is its motion
    arm        two arms, the MH5 and the UR5e
    sensors    range sensor and camera
    equipment  battery, blade, LED
    gazebo     topics that a robot in Gazebo lacks
"""
