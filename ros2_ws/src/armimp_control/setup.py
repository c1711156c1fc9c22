"""Installation of armimp_control, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
