"""Attitudes as messages of a ROS 2 bag."""
