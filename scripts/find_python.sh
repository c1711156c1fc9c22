#!/bin/sh
# Print the path of the Python interpreter to make .venv with.
#
# The ROS wheels exist for 64-bit CPython 3.10 to 3.14 on x86_64 Linux with glibc 2.28 or newer.
# Candidates are run, not only looked up: pyenv puts shims on the path that fail. A candidate with
# the module ensurepip wins over one without (Debian and Ubuntu ship python3 without it).
# Exit status: 0 found, 3 found but without ensurepip, 1 none (with one line saying why).
set -eu

# Runs on any Python from 2.7 on, so that an old one can be named in the message.
probe='
import os, platform, sys, sysconfig

def unsuitable():
    if not (3, 10) <= sys.version_info[:2] <= (3, 14):
        return "is Python %d.%d" % sys.version_info[:2]
    if platform.python_implementation() != "CPython":
        return "is not CPython"
    if sys.platform != "linux" or platform.machine() != "x86_64" or sys.maxsize < 2**32:
        return "is not for 64-bit x86_64 Linux"
    try:
        glibc = tuple(map(int, os.confstr("CS_GNU_LIBC_VERSION").split()[1].split(".")))
    except (AttributeError, IndexError, OSError, ValueError):
        return "does not use glibc"
    if glibc < (2, 28):
        return "uses glibc older than 2.28"
    if sysconfig.get_config_var("Py_GIL_DISABLED"):
        return "is a free-threaded build"
    return None

reason = unsuitable()
if reason is not None:
    print("no:" + reason)
    sys.exit()
executable = sys.executable
# An activated environment may be the one that is about to be replaced: use what it was made from.
if os.path.exists(os.path.join(os.path.dirname(os.path.dirname(executable)), "pyvenv.cfg")):
    executable = os.path.realpath(executable)
try:
    import ensurepip
except ImportError:
    print("bare:" + executable)
else:
    print("yes:" + executable)
'

bare=''
reasons=''

# Whoever names an interpreter should know when another one is taken.
explain() {
    [ -z "${PYTHON:-}" ] || [ -z "$reasons" ] ||
        echo "armimp: PYTHON=$PYTHON is not suitable, using another ($reasons)" >&2
}

for name in ${PYTHON:+"$PYTHON"} python3 python3.13 python3.12 python3.11 python3.10 python3.14; do
    if ! command -v "$name" >/dev/null 2>&1; then
        [ "$name" != "${PYTHON:-}" ] || reasons="$name does not exist"
        continue
    fi
    # -S: leave out site-packages, whose start-up files may start the interpreter anew.
    answer=$("$name" -E -S -c "$probe" 2>/dev/null) || answer='no:does not run'
    case $answer in
        yes:*)
            explain
            echo "${answer#yes:}"
            exit 0
            ;;
        bare:*) : "${bare:=${answer#bare:}}" ;;
        *) reasons="$reasons${reasons:+, }$name ${answer#no:}" ;;
    esac
done
if [ -n "$bare" ]; then
    explain
    echo "$bare"
    exit 3
fi
echo "armimp: no suitable Python; needs 64-bit CPython 3.10 to 3.14 and glibc 2.28 or newer on" \
    "x86_64 Linux (${reasons:-none found}); name one with 'make PYTHON=/path/to/python'" >&2
exit 1
