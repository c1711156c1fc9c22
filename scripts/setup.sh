#!/bin/sh
# Make .venv with every pinned package and the armimp packages, or bring it up to date.
#
# Two stamps make later calls quick: one over what the environment is made from (any change makes
# it anew), one over the installation files of the armimp packages (any change reinstalls these).
# Environment variable PYTHON names the interpreter to use; see scripts/find_python.sh.
set -eu
CDPATH='' cd -- "$(dirname -- "$0")/.."

venv=.venv
pip="$venv/bin/python -m pip"
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1 PIP_USER=0 PIP_REQUIRE_VIRTUALENV=0

# The settings of pip on this machine may name places that are not there, of which pip warns once for
# each package: only what ends an installation is shown.
quiet_pip() { patiently $pip --quiet --quiet "$@"; }

# On a terminal, show a dot every few seconds for as long as a command takes.
patiently() {
    [ -t 2 ] || { "$@"; return; }
    (while sleep 3 && kill -0 $$ 2>/dev/null; do printf . >&2; done) 9>&- &
    dots=$! status=0
    "$@" || status=$?
    kill $dots
    echo >&2
    return $status
}

say() { echo "armimp: $*" >&2; }

# Root or a sudo that asks nothing can add the module which Debian and Ubuntu split off.
install_ensurepip() {
    command -v apt-get >/dev/null 2>&1 || return 1
    if [ "$(id -u)" = 0 ]; then
        root='env'
    elif sudo -n true 2>/dev/null; then
        root='sudo -n env'
    else
        return 1
    fi
    say "$1 lacks ensurepip: installing $2"
    apt="$root DEBIAN_FRONTEND=noninteractive apt-get -qq -o Dpkg::Use-Pty=0"
    # On a fresh system the package lists are empty or stale.
    $apt install -y --no-install-recommends "$2" >/dev/null 2>&1 ||
        { $apt update && $apt install -y --no-install-recommends "$2" >/dev/null; } || return 1
    "$1" -c 'import ensurepip' 2>/dev/null
}

# Without those rights, put pip into the environment from its wheel, which runs as it is.
fetch_pip() {
    "$1" -m venv --without-pip "$venv" && "$venv/bin/python" - <<'EOF'
import hashlib
import pathlib
import subprocess
import sys
import urllib.request

URL = (
    "https://files.pythonhosted.org/packages/07/25/"
    "ee8c38ae72d66b844ce8eb9711ba905dba21ca1a8a0c960057c41cd23337/pip-26.3-py3-none-any.whl"
)
SHA256 = "f3b60b20ffaadd4415ed7957212a38ac63fa4c5fa375bd0f4a797777940fad13"

try:
    wheel = urllib.request.urlopen(URL, timeout=60).read()
except OSError as error:
    sys.exit(f"armimp: cannot download pip: {error}")
if hashlib.sha256(wheel).hexdigest() != SHA256:
    sys.exit("armimp: the pip that was downloaded is not the one expected")
path = pathlib.Path(sys.prefix, pathlib.PurePosixPath(URL).name)
path.write_bytes(wheel)
install = [sys.executable, f"{path}/pip", "install", "--quiet", "--no-index", str(path)]
sys.exit(subprocess.run(install, check=False).returncode)
EOF
}

make_environment() {
    status=0
    python=$(scripts/find_python.sh) || status=$?
    [ "$status" = 0 ] || [ "$status" = 3 ] || exit 1
    rm -rf "$venv"
    say "making $venv with $python (takes a minute or two)"
    if [ "$status" = 3 ]; then
        package="python$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-venv"
        if install_ensurepip "$python" "$package"; then
            "$python" -m venv "$venv"
        elif ! fetch_pip "$python" 2>/dev/null; then
            rm -rf "$venv"
            say "$python cannot make virtual environments: run 'sudo apt-get install $package'"
            exit 1
        fi
    else
        "$python" -m venv "$venv"
    fi
    # The pinned pip and build back end first, then nothing outside the lock file is ever used.
    awk '!/^ / { take = /^(pip|setuptools)==/ } take' requirements.txt >"$venv/first.txt"
    say "installing what requirements.txt lists"
    # To compile all modules would take as long as to install them: see below.
    quiet_pip install --no-compile --require-hashes -r "$venv/first.txt"
    quiet_pip install --no-compile --require-hashes --no-build-isolation \
        -r requirements.txt -r requirements-dev.txt
}

install_packages() {
    say "installing the packages of this project"
    # Mode "compat" puts the source folders on the path, where mypy and other tools see them.
    set --
    # Only what is a package: of one that moved, an old checkout keeps compiled files.
    for package in ros2_ws/src/armimp*/setup.py examples/armimp*/setup.py; do
        set -- "$@" --editable "./${package%/setup.py}"
    done
    # setuptools warns at length that this mode will go one day; the version is pinned.
    PYTHONWARNINGS=ignore quiet_pip install --no-build-isolation --no-deps --use-pep517 \
        --config-settings editable_mode=compat "$@"
}

# Two calls at once must not build into the same folder.
if command -v flock >/dev/null 2>&1; then
    exec 9<scripts/setup.sh
    flock 9
fi

environment=$({ pwd -P && cat requirements.txt requirements-dev.txt scripts/setup.sh; } | cksum)
packages=$(cat ros2_ws/src/armimp*/setup.* examples/armimp*/setup.* | cksum)

stamp() { [ -f "$venv/$1" ] && cat "$venv/$1" || true; }

if [ "$(stamp .environment)" != "$environment" ] || [ ! -x "$venv/bin/python" ] ||
    { [ -n "${PYTHON:-}" ] && [ "$(stamp .python)" != "$PYTHON" ]; }; then
    make_environment
    echo "${PYTHON:-}" >"$venv/.python"
    echo "$environment" >"$venv/.environment"
fi
if [ "$(stamp .packages)" != "$packages" ] || [ ! -x "$venv/bin/armimp" ]; then
    install_packages
    # What a run imports is compiled now, so that the first one starts as soon as any other.
    "$venv/bin/python" -c 'import armimp_bringup.cli, armimp_bringup.offline, armimp_bringup.replay
import armimp_control.node, armimp_sim.node, armimp_estimation.node
import armimp_estimation.figures, armimp_estimation.report.run'
    echo "$packages" >"$venv/.packages"
fi
