"""Execution: the token game, the event log, agreement, and the standalone executor. No ROS in
here."""
