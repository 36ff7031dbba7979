"""The ROS edge: thin adapters between messages and the core. Callbacks only enqueue."""
