"""Judging of a running driver: recording it, the judgement without ROS, and the command."""
