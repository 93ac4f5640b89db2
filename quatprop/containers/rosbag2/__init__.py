"""ROS 2 bags: a folder or a database, in one part or several."""
