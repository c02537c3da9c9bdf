"""The arm: a Yaskawa Motoman MH5 that cuts triangles, and what an attacker may do to its task.

::

    mh5        the arm's kinematics
    inverse    from places and orientations of the tool to joint angles
    task       the polygon that is cut, and where a recorded run cuts it
    sabotage   the modifications of the task, put into recorded runs
    noise      new runs like recorded ones
    program    the arm's own run: from home round the part and back
    cutter     the arm as a robot of the world
    envelope   runs just outside a tolerance, as training data
"""
