"""Bridge to a robot that ros2_control drives."""
