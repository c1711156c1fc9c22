"""Installation of armimp_ros2_control, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
