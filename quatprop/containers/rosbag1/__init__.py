"""ROS 1 bags: records, chunks and indexes, whole or damaged."""
