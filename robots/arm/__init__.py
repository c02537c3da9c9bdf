"""Two arms: a Yaskawa Motoman MH5 that cuts triangles, with what an attacker may do to its task, and a UR5e that takes
the lid off a motor and puts it back, with what may get in its way.

::

    mh5         the arm's kinematics
    kinematics  inverse kinematics, and straight ways of the tool
    task        the polygon that is cut, and where a recorded run cuts it
    program     runs as the arm's program makes them, and as they would be recorded
    sabotage    the modifications of the task, put into recorded runs; runs just outside a tolerance
    cutter      the arm as a robot of the world

    ur5e        the other arm's parameters
    dynamics    the forces in an arm that moves
    trajectory  from the points of a trajectory to every control cycle
    machine     an arm under control, which something may push
    bench       the motor, its lid, and people: what pushes
    reassembly  the task, and recorded runs of it
    handler     the UR5e as a robot of the world
"""
