#!/bin/sh
# Sourced by the scripts that fetch what some tests need from the system's packages.
#
#   missing_packages PACKAGE...        prints those that are not installed
#   install_packages WHO PACKAGE...    installs them; where it cannot, says why and ends the script with 0
#
# By apt-get (Debian, Ubuntu; as root or where sudo asks for no password), without their recommendations and
# without removing anything. The tests skip where something could not be had.

as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo -n "$@"; fi
}

say() { printf '%s: %s\n' "$who" "$*" >&2; }

consequence='the tests that need it will skip'

without() {
    say "none: $*; $consequence"
    exit 0
}

missing_packages() {
    for package in "$@"; do
        case $(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true) in
            *' installed') ;;
            *) printf ' %s' "$package" ;;
        esac
    done
}

apt_get() {
    as_root env DEBIAN_FRONTEND=noninteractive NEEDRESTART_SUSPEND=1 \
        apt-get -q -y -o DPkg::Lock::Timeout=120 "$@" >/dev/null 2>&1 </dev/null
}

install_packages() {
    who=$1
    shift
    missing=$(missing_packages "$@")
    [ -n "$missing" ] || return 0
    command -v apt-get >/dev/null 2>&1 || without "apt-get, which installs it, is not here; missing:$missing"
    as_root true 2>/dev/null ||
        without "run as root: apt-get install --no-install-recommends$missing"
    say "installing:$missing"
    # shellcheck disable=SC2086
    if ! apt_get install --no-install-recommends --no-remove $missing; then
        apt_get update || true
        apt_get install --no-install-recommends --no-remove $missing ||
            without "apt-get cannot install$missing (no network?)"
    fi
}
