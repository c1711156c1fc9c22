"""Installation of armimp_bringup, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
