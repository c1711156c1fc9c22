#!/bin/bash
# Run a command of armimp in an image: `arm_sim ...`, `armimp run ...`.
set -eu
PATH=/opt/armimp/venv/bin:$PATH
if [ -e /opt/armimp/install/setup.bash ]; then
    set +u # the scripts of ROS read variables that are not there
    # shellcheck disable=SC1090,SC1091
    . "/opt/ros/${ROS_DISTRO:-jazzy}/setup.bash"
    # shellcheck disable=SC1091
    . /opt/armimp/install/setup.bash
    set -u
    for package in /opt/armimp/install/lib/armimp_*; do
        PATH=$package:$PATH
    done
fi
export PATH
exec "$@"
