"""Two arms: a Yaskawa Motoman MH5 that cuts triangles, with what an attacker may do to its task, and a UR5e that takes
the lid off a motor and puts it back, with what may get in its way.

::

    mh5        the arm's kinematics
    inverse    from places and orientations of the tool to joint angles
    task       the polygon that is cut, and where a recorded run cuts it
    sabotage   the modifications of the task, put into recorded runs
    noise      new runs like recorded ones
    program    the arm's own run: from home round the part and back
    cutter     the arm as a robot of the world
    envelope   runs just outside a tolerance, as training data

    ur5e        the other arm's parameters
    dynamics    the forces in an arm that moves
    trajectory  from the points of a trajectory to every control cycle
    machine     an arm under control, which something may push
    bench       the motor, its lid, and people: what pushes
    twin        from places to trajectories
    reassembly  the task, and recorded runs of it
    handler     the UR5e as a robot of the world
"""
