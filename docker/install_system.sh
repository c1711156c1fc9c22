#!/bin/bash
# What the packages need from Ubuntu in a ROS image: by rosdep from their package.xml, and venv.
set -eu
cd -- "$(dirname -- "$0")/.."

export DEBIAN_FRONTEND=noninteractive
apt-get update
apt-get install --yes --no-install-recommends python3-venv
rosdep update --rosdistro "${ROS_DISTRO:-jazzy}"
rosdep install --rosdistro "${ROS_DISTRO:-jazzy}" --from-paths ros2_ws/src --ignore-src --default-yes \
    --dependency-types exec
rm -rf /var/lib/apt/lists/*
