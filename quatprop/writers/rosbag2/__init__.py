"""ROS 2 bag folders."""
