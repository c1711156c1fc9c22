"""The check of a running driver: its recording, its rules without ROS, and the command."""
