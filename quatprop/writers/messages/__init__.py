"""Attitudes as encoded ROS and Foxglove messages."""
