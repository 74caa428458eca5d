"""The project's own ROS 2 messages; the ``.msg`` files are the source."""
