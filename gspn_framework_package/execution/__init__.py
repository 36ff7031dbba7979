"""Execution: the token game, the event log, agreement, and the standalone executor. Nothing here
imports ROS."""
