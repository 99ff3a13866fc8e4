#!/bin/sh
# Everything that Haptic Cushion needs on this machine: tools/setup.sh run|test|docs|s3
#
#   run    a .venv with the program and the extras `figures`, `live` and `page`
#   test   the extra `dev` as well
#   docs   the extra `docs`, too
#   s3     what the tests of S3 storages need, too
#
# PyAudio, the core and the simulated rig's library are compiled during the installation.
# Where the compiler or a header for that is missing, the system's package manager installs it (Debian,
# Ubuntu; as root or where sudo asks for no password), else the command to run is printed. Where the
# compiler is there but fails, the set-up ends and says why.
# Sound servers are left alone: nothing is ever removed or reconfigured.
#
# Environment: PYTHON (which Python to use), CC, CPPFLAGS, CFLAGS (as for every build), and pip's own.
# constraints.txt says which versions pip installs (`make lock` renews it), so that it never has to try many.
# A second run finds .venv/setup-stamp and is done in a moment.
set -eu

case ${1-} in
    run) wanted=figures,live,page,study ;;
    test) wanted=figures,live,page,tray,films,remote,cluster,dev ;;
    docs) wanted=figures,live,page,tray,films,remote,cluster,dev,docs ;;
    s3) wanted=figures,live,page,tray,films,remote,cluster,dev,docs,s3,dev-s3 ;; # docs: one set-up for both
    *)
        echo 'usage: tools/setup.sh run|test|docs|s3' >&2
        exit 2
        ;;
esac
goal=$1

unset CDPATH PYTHONPATH PYTHONHOME
cd "$(dirname "$0")/.."
root=$(pwd -P)
venv_python=.venv/bin/python
core=audioflinger_hook/core
transform=audioflinger_hook/transform
plugin=audioflinger_hook/plugin
stamp=.venv/setup-stamp
unfinished=.venv/setup-unfinished # there while .venv is being changed: it survives a kill

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
log=$scratch/log

say() { printf 'setup: %s\n' "$*" >&2; }

die() {
    printf 'setup: error: %s\n' "$*" >&2
    exit 1
}

# Whether the log of pip or apt-get tells of a connection that failed.
lost_network() {
    grep -qE "$network_errors" "$log"
}
network_errors='NewConnectionError|NameResolutionError|ConnectTimeout|ReadTimeout|ProxyError|Network is unreachable'
network_errors="$network_errors|Temporary failure resolving|Could not resolve|Could not connect|Unable to connect"

# ---------------------------------------------------------------------------------------- which Python

# Prints the interpreter behind the command $1 (a venv's or pyenv's shim leads to the real one) and its version.
interpreter_of() {
    "$1" -c '
import os, sys
base = getattr(sys, "_base_executable", None) or sys.executable
print(base if os.path.exists(base) else sys.executable)
print("%d.%d" % sys.version_info[:2])
sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

find_python() {
    if [ -n "${PYTHON-}" ]; then
        if found=$(interpreter_of "$PYTHON"); then
            python=$(printf '%s\n' "$found" | head -n 1)
            return
        fi
        [ -n "$found" ] || die "PYTHON=$PYTHON is not a Python that runs"
        die "PYTHON=$PYTHON is Python $(printf '%s\n' "$found" | tail -n 1); 3.11 or newer is needed"
    fi
    too_old=
    for candidate in python3 python3.13 python3.12 python3.11 python3.14 /usr/bin/python3; do
        if found=$(interpreter_of "$candidate"); then
            python=$(printf '%s\n' "$found" | head -n 1)
            return
        fi
        [ -n "$too_old" ] || [ -z "$found" ] || too_old=" (python3 is $(printf '%s\n' "$found" | tail -n 1))"
    done
    say "error: Python 3.11 or newer is needed$too_old. Install one, for example on"
    say "    Debian 12, Ubuntu 24.04 or newer:  sudo apt-get install python3"
    say "    Ubuntu 22.04:                      sudo apt-get install python3.11 python3.11-venv python3.11-dev"
    die "or name one: make $goal PYTHON=/path/to/python3.12"
}

# ------------------------------------------------------------------------- what the system has to offer

read_build_facts() {
    "$python" - >"$scratch/facts" <<'PY'
import sysconfig
paths = sysconfig.get_paths()
print(sysconfig.get_python_version())
print(paths["include"])
print(paths["platinclude"])
print(sysconfig.get_config_var("CC") or "cc")
PY
    {
        read -r version
        read -r include
        read -r platinclude
        read -r python_cc
    } <"$scratch/facts"
}

# Compiles the lines after $1, which is the compiler or "" for the one found.
builds() {
    with=${1:-$compiler}
    shift
    printf '%s\n' "$@" 'int main(void) { return 0; }' >"$scratch/probe.c"
    # compilers and flags are lists of words
    # shellcheck disable=SC2086
    $with ${CPPFLAGS-} ${CFLAGS-} -I"$include" -I"$platinclude" \
        "$scratch/probe.c" -o "$scratch/probe" >>"$log" 2>&1
}

has_header() { # name, folders to look in while there is no compiler
    header=$1
    shift
    [ -z "$compiler" ] || {
        builds '' "#include <$header>"
        return
    }
    for folder in "$@"; do
        [ ! -f "$folder/$header" ] || return 0
    done
    return 1
}

# Sets missing to the words among: venv compiler Python.h portaudio.h
look_for_what_is_missing() {
    missing=
    read_build_facts
    "$python" -c 'import ensurepip, venv' 2>>"$log" || missing="$missing venv"
    compiler=
    for candidate in ${CC:+"$CC"} "$python_cc" cc gcc clang; do
        if builds "$candidate" '#include <stdio.h>'; then
            compiler=$candidate
            break
        fi
    done
    if [ -z "$compiler" ]; then
        missing="$missing compiler"
    elif [ "$compiler" = "$python_cc" ]; then
        unset CC
    else
        export CC="$compiler" # else the build would ask for the compiler that made this Python
    fi
    has_header Python.h "$include" "$platinclude" || missing="$missing Python.h"
    has_header portaudio.h /usr/include /usr/local/include || missing="$missing portaudio.h"
}

# Prints the packages of the package manager $1 for what is missing.
packages_for() {
    if [ "$(readlink -f "$python")" = "$(readlink -f /usr/bin/python3)" ]; then
        name=python3
    else
        name=python$version
    fi
    short=python$(printf '%s' "$version" | tr -d .)
    for word in $missing; do
        case $1:$word in
            apt-get:venv) echo "$name-venv" ;;
            apt-get:compiler) echo gcc libc6-dev ;;
            apt-get:Python.h) echo "$name-dev" ;;
            apt-get:portaudio.h) echo portaudio19-dev libasound2-plugins ;; # the second for live sound
            dnf:Python.h) echo "$name-devel" ;;
            zypper:Python.h) echo "$short-devel" ;;
            pacman:Python.h | pacman:venv) echo python ;;
            *:venv) echo "$name" ;;
            *:compiler) echo gcc ;;
            pacman:portaudio.h) echo portaudio ;;
            *:portaudio.h) echo portaudio-devel ;;
        esac
    done | sort -u | tr '\n' ' ' | sed 's/ $//'
}

command_to_run() {
    packages=$(packages_for "$1")
    case $1 in
        apt-get)
            first=
            # shellcheck disable=SC2086
            apt-get --simulate install --no-install-recommends $packages >/dev/null 2>&1 ||
                first="${sudo}apt-get update && "
            echo "$first${sudo}apt-get install --no-install-recommends $packages"
            ;;
        pacman) echo "${sudo}pacman -S --needed $packages" ;;
        *) echo "${sudo}$1 install $packages" ;;
    esac
}

apt_get() { # as root: no questions, no removals, no restart of anybody's services
    # shellcheck disable=SC2086
    $elevate env DEBIAN_FRONTEND=noninteractive NEEDRESTART_SUSPEND=1 \
        apt-get -q -y -o DPkg::Lock::Timeout=120 "$@" >>"$log" 2>&1 </dev/null
}

install_packages() {
    say "installing with apt-get: $*"
    : >"$log"
    apt_get install --no-install-recommends --no-remove "$@" || {
        apt_get update || true # one unreachable source need not matter
        apt_get install --no-install-recommends --no-remove "$@"
    }
}

require_system() {
    look_for_what_is_missing
    [ -n "$missing" ] || return 0

    case $missing in
        *venv* | *Python.h*)
            case $python in
                /usr/bin/*) ;;
                *)
                    die "$python lacks its own part of:$missing; name a complete one," \
                        "for example: make $goal PYTHON=/usr/bin/python3"
                    ;;
            esac
            ;;
    esac

    manager=
    for candidate in apt-get dnf pacman zypper; do
        if command -v "$candidate" >/dev/null 2>&1; then
            manager=$candidate
            break
        fi
    done
    [ -n "$manager" ] ||
        die "missing for the build:$missing; install a C compiler and the headers of Python and PortAudio"

    elevate=
    sudo=
    may_install=no
    if [ "$(id -u)" -eq 0 ]; then
        may_install=yes
    elif command -v sudo >/dev/null 2>&1; then
        sudo='sudo '
        if sudo -n true 2>/dev/null; then
            elevate='sudo -n'
            may_install=yes
        fi
    fi

    if [ "$manager" = apt-get ] && [ "$may_install" = yes ]; then
        # shellcheck disable=SC2046
        install_packages $(packages_for apt-get) || {
            ! lost_network || die "no network: apt-get cannot reach its sources. Once it can, run make $goal again"
            tail -n 20 "$log" >&2
            die "apt-get could not install them; run this yourself, then make $goal again:" \
                "$(command_to_run apt-get)"
        }
        look_for_what_is_missing
        [ -n "$missing" ] || return 0
        tail -n 20 "$log" >&2
        die "still missing for the build:$missing"
    fi

    say "missing for the build:$missing"
    if [ "$(id -u)" -eq 0 ] || [ -n "$sudo" ]; then
        say "run this, then make $goal again:"
    else
        say "have root run this, then make $goal again:"
    fi
    printf '    %s\n' "$(command_to_run "$manager")" >&2
    exit 1
}

# ------------------------------------------------------------------------------------------- the .venv

# What the stamp says of a finished set-up; the extras follow on a line of their own.
stamp_head() {
    echo "$root"
    cksum pyproject.toml constraints.txt setup.py tools/setup.sh "$core"/*.[ch] "$core"/drive/* \
        "$transform"/native/* "$plugin"/native/* device/native/*
}

# Whether PYTHON, where it is given, is the Python that .venv was made from.
right_python() {
    [ -n "${PYTHON-}" ] || return 0
    [ "$(interpreter_of "$PYTHON")" = "$(interpreter_of "$venv_python")" ]
}

up_to_date() {
    [ -f "$stamp" ] && [ ! -e "$unfinished" ] || return 1
    [ "$(sed '$d' "$stamp")" = "$(stamp_head)" ] || return 1
    case $(tail -n 1 "$stamp") in
        "$wanted" | "$wanted",*) ;;
        *) return 1 ;;
    esac
    right_python && pyaudio_loads && core_loads
}

pyaudio_loads() {
    "$venv_python" -c 'import pyaudio' 2>"$scratch/load-errors"
}

# Whether what is compiled is there and loads.
core_loads() {
    "$venv_python" -c "
from audioflinger_hook.core.compiled_core import library
from device.blocks import Compiled
library(), Compiled()" 2>"$scratch/load-errors"
}

# Prints why .venv cannot be kept; nothing where it can.
why_remake() {
    if [ -e "$unfinished" ]; then
        echo 'an earlier set-up was interrupted'
    elif ! interpreter_of "$venv_python" >/dev/null; then
        echo 'its Python is gone or older than 3.11'
    elif ! "$venv_python" -c 'import pip' 2>/dev/null; then
        echo 'it has no pip'
    elif ! head -n 2 .venv/bin/pip 2>/dev/null | grep -qF "$root/.venv/"; then
        echo 'it was made in another folder'
    elif ! right_python; then
        echo "it was not made from PYTHON=$PYTHON"
    fi
}

make_venv() {
    rm -rf .venv
    mkdir .venv
    : >"$unfinished"
    "$python" -m venv .venv >"$log" 2>&1 || {
        cat "$log" >&2
        die "$python could not make .venv"
    }
}

# pip may try many versions of packages that exclude each other, for hours; this ends it, and says so.
resolving_s_max=120
pip_install() {
    PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1 \
        "$venv_python" -m pip install --constraint constraints.txt --editable "$1" >"$log" 2>&1 </dev/null &
    pip=$!
    waited_s=0
    while kill -0 "$pip" 2>/dev/null; do
        sleep 1
        waited_s=$((waited_s + 1))
        if [ "$waited_s" -gt "$resolving_s_max" ] && grep -q 'multiple versions' "$log" &&
            ! grep -q '^Installing collected packages' "$log"; then
            kill "$pip" 2>/dev/null || true
            rm -f "$unfinished"
            tried=$(grep -o 'multiple versions of [^ ]*' "$log" | sort -u | sed 's/.* of //' | tr '\n' ' ')
            die "pip found no versions that go together within $resolving_s_max s; it tried many of: $tried." \
                "Remove what constrains them (PIP_CONSTRAINT, pip.conf), or use a newer pip"
        fi
    done
    wait "$pip"
}

install_project() {
    say "installing the Python packages (the first time takes a minute or two)"
    rm -f "$core"/*.so "$plugin"/*.so device/*.so # what was built of other sources must not stand in
    pip_install ".[$wanted]" && return
    if ! lost_network; then
        without_figures=${wanted#figures}
        if pip_install ".${without_figures:+[${without_figures#,}]}"; then
            say "matplotlib could not be installed: the demo leaves out report.png." \
                "To try again: .venv/bin/python -m pip install matplotlib"
            return
        fi
    fi
    rm -f "$unfinished" # pip has ended by itself: what it left is whole
    ! lost_network ||
        die "no network: pip cannot reach its package index. Once it can, run make $goal again"
    tail -n 60 "$log" >&2
    die "pip could not install the project; its messages are above"
}

if up_to_date; then
    exit 0
fi
reason=$(why_remake)
if [ -z "$reason" ]; then
    python=$(interpreter_of "$venv_python" | head -n 1)
else
    find_python
fi
require_system
if [ -z "$reason" ]; then
    : >"$unfinished"
    rm -f "$stamp"
else
    if [ -e .venv ] || [ -L .venv ]; then
        say "making .venv anew: $reason"
    fi
    make_venv
fi
install_project
pyaudio_loads || {
    tail -n 3 "$scratch/load-errors" >&2
    die "what was compiled does not load; remove .venv and run make $goal again"
}
core_loads || {
    tail -n 1 "$scratch/load-errors" >&2
    die "the core in C could not be compiled. Install a C compiler (gcc), then run make $goal again;" \
        "to see more: .venv/bin/python -m pip install --verbose --no-deps --editable ."
}
{
    stamp_head
    echo "$wanted"
} >"$stamp"
rm -f "$unfinished"
say "done: .venv is ready"
