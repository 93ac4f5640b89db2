"""ROS 1 bags: records, chunks and indexes, intact or damaged."""
