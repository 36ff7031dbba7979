"""The simulated world: a room, robots that physically move in it, and their ROS interface.

``room``, ``room_file``, ``room_check``
    walls, obstacles, locations, waiting bays, temperature field, and the file that describes them.
``made_room``, ``map_room``, ``sdf_world``
    rooms made of maps of map_server and of worlds of Gazebo.
``bodies``, ``physics``
    the room and the robots as PyBullet bodies with wheels and contacts.
``grid``, ``avoidance``, ``yielding``, ``navigation``
    navigation from a pose to a goal: global path, velocity among other robots, making room for
    them, the navigator of one robot.
``driving_team``, ``faults``, ``patrol``, ``traffic``, ``referee``
    the world without ROS: driving robots, what goes wrong, the patrol's actions, the rule of the
    plan, and a referee that watches.
``node``, ``robot_topics``, ``robot_urdf``, ``messages``, ``move_base``, ``gazebo_services``
    the world as a ROS node.
``base_client``, ``patrol_actions``
    plan actions on it.
``camera``, ``recording``, ``film``, ``window``
    pictures of it.

Also here: ``parameters``, ``parking``, ``people``, ``shop``, ``shop_node``.
"""
