"""Installation of armimp, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
