"""The simulated world: a room, robots that physically move in it, and their ROS interface.

``room``, ``room_file``, ``room_check``
    walls, obstacles, locations, waiting bays, temperature field, and the file that describes them.
``made_room``, ``map_room``, ``sdf_world``, ``shapes``
    rooms made of maps of map_server and of worlds of Gazebo.
``bodies``, ``physics``
    the room and the robots as PyBullet bodies with wheels and contacts.
``grid``, ``avoidance``, ``yielding``, ``navigation``
    navigation from a pose to a goal: global path, velocity among other robots, making room for
    them, the navigator of one robot.
``urdf``, ``urdf_robot``, ``robot_urdf``
    robots of the user, and the description of ours.
``driving_team``, ``faults``, ``models``, ``patrol``, ``traffic``, ``referee``
    the world without ROS: driving robots, what goes wrong, what is put into the room while it runs,
    the patrol's actions, the rule of the plan, and a referee that watches.
``node``, ``robot_topics``, ``messages``, ``move_base``, ``gazebo_services``
    the world as a ROS node.
``base_client``, ``patrol_actions``
    plan actions on it.
``camera``, ``recording``, ``film``, ``window``
    pictures of it.

Also here: ``counter``, ``parameters``, ``parking``, ``people``, ``shop``, ``shop_node``.
"""
