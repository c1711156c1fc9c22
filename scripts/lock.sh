#!/bin/sh
# Write requirements.txt and requirements-dev.txt: every package pinned, with the hashes of its files,
# for Python 3.10 to 3.14.
#
# Usage: scripts/lock.sh [--upgrade]. Without --upgrade the pins already there are kept if they fit.
set -eu
CDPATH='' cd -- "$(dirname -- "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=$(scripts/find_python.sh)
"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet uv==0.13.8

for name in requirements requirements-dev; do
    "$work/venv/bin/uv" pip compile --quiet --universal --python-version 3.10 \
        --no-header --generate-hashes --annotation-style line "$@" "$name.in" --output-file "$name.txt"
    {
        echo "# Made from $name.in by scripts/lock.sh; do not edit."
        # Only Linux is supported, so pins for other systems are left out, with their hashes.
        awk '!/^ / { skip = /sys_platform == .win32.|^# Made from/ } !skip' "$name.txt"
    } >"$work/$name.txt"
    cp "$work/$name.txt" "$name.txt"
done
