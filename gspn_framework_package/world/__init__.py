"""The simulated world: a room, robots that really move in it, and their ROS interface.

``room``
    the room file: walls, obstacles, locations, waiting bays, temperature field.
``physics``
    the room and the robots as PyBullet bodies with wheels and contacts.
``grid``, ``avoidance``, ``navigation``
    the way from a pose to a goal: global path, velocity among other robots, the navigator of one robot.
``traffic``, ``referee``
    the world without ROS: N robots that drive, and the one who watches the rules.
``node``, ``move_base``, ``patrol_actions``
    the world as a ROS node, and plan actions on it.
"""
