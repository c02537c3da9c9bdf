"""Two arms: a Yaskawa Motoman MH5 that cuts triangles, with attacks on its task, and a UR5e that takes the lid off a
motor and puts it back, with disturbances.

::

    kinematics  inverse kinematics, straight lines of the tool, interpolation of trajectories

    task        the MH5, the polygon that it cuts, and runs of its program
    sabotage    modifications of the task, applied to recorded runs; runs just outside a tolerance
    mh5         the MH5 as a robot of the world

    dynamics    the UR5e, and the forces in a moving arm
    machine     an arm under control, which external forces may push
    bench       the motor, its lid, and people: external forces
    reassembly  the reassembly program, and simulated recordings of it
    ur5e        the UR5e as a robot of the world
"""
