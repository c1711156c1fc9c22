"""Installation of armimp_estimation, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
