"""Attitudes as messages of a ROS 1 bag."""
