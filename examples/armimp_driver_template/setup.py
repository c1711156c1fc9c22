"""Installation of armimp_driver_template, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
