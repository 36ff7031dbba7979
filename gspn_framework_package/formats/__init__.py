"""Readers and writers of net files, each to and from the one model. No ROS."""
