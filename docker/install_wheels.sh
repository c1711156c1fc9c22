#!/bin/sh
# Make /opt/armimp/venv with the pinned wheels of requirements.txt.
#
# Usage: docker/install_wheels.sh [--beside-ros]. With --beside-ros the ROS wheels are left out: a
# full ROS 2 installation brings all that, and the environment sees the system's Python packages.
set -eu
CDPATH='' cd -- "$(dirname -- "$0")/.."

venv=/opt/armimp/venv
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PIP_NO_INPUT=1 PIP_ROOT_USER_ACTION=ignore

wheels=$(mktemp)
trap 'rm -f "$wheels"' EXIT
case ${1:-} in
    '')
        python3 -m venv "$venv"
        cp requirements.txt "$wheels"
        ;;
    --beside-ros)
        python3 -m venv --system-site-packages "$venv"
        awk '!/^ / { take = !/^ros-/ } take' requirements.txt >"$wheels"
        ;;
    *)
        echo "usage: $0 [--beside-ros]" >&2
        exit 2
        ;;
esac
# The pinned pip and build back end first, then nothing outside the lock file is used.
first=$(mktemp)
awk '!/^ / { take = /^(pip|setuptools)==/ } take' "$wheels" >"$first"
"$venv/bin/python" -m pip install --quiet --require-hashes -r "$first"
"$venv/bin/python" -m pip install --quiet --require-hashes --no-build-isolation -r "$wheels"
rm "$first"
