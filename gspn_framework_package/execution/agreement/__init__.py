"""Agreement: every replica of a team sees one valid sequence of firings. No ROS in here."""
