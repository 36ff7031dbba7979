"""The model: net, marking, policy, plan, errors. Immutable values, no I/O, no ROS."""
