"""What the armimp packages share: topics, codecs, parameters, lifecycle, real time; no physics.

Modules that need rclpy are imported by name and never from here, so that the mathematics can be
used without ROS.
"""
