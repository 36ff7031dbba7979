"""The robots of a team at work, without ROS: the host of a robot's replica, and what carries its
messages."""
