#!/bin/bash
# Install the armimp packages: into /opt/armimp/venv, or beside ROS with colcon.
#
# Usage: docker/install_packages.sh [--beside-ros]. With --beside-ros the workspace is built into
# /opt/armimp/install against /opt/ros/$ROS_DISTRO.
set -eu
cd -- "$(dirname -- "$0")/.."

root=/opt/armimp
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore

case ${1:-} in
    '')
        # Editable: the sources stay where they are, and the nodes compile beside them.
        editable=()
        for package in ros2_ws/src/armimp*; do
            editable+=(--editable "./$package")
        done
        PYTHONWARNINGS=ignore "$root/venv/bin/python" -m pip install --quiet --no-build-isolation \
            --no-deps --use-pep517 --config-settings editable_mode=compat "${editable[@]}"
        ;;
    --beside-ros)
        set +u # the scripts of ROS read variables that are not there
        # shellcheck disable=SC1090
        . "/opt/ros/${ROS_DISTRO:-jazzy}/setup.bash"
        set -u
        # By the environment's interpreter, so that it becomes that of the executables.
        "$root/venv/bin/python" -m colcon --log-base "$root/log" build \
            --base-paths ros2_ws/src --build-base "$root/build" --install-base "$root/install" \
            --merge-install
        rm -rf "$root/log" "$root/build"
        ;;
    *)
        echo "usage: $0 [--beside-ros]" >&2
        exit 2
        ;;
esac
