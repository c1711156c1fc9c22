"""Installation of armimp_sim, an ament_python package; see setup.cfg."""

from setuptools import setup

setup()
