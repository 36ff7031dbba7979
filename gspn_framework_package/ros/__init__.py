"""The ROS layer: thin adapters between ROS messages and the core. Callbacks only enqueue."""
