#!/bin/sh
# The sound servers that the tests marked `servers` run against: PulseAudio, PipeWire with WirePlumber and
# pipewire-pulse, ALSA's pulse plugin, and the small programs that play and record.
#
# Installs them with apt-get (Debian, Ubuntu; as root or where sudo asks for no password), without their
# recommendations and without removing anything. pipewire-alsa stays out: it conflicts with PulseAudio.
# Where somebody's sound server runs nothing is installed, since a second one could take its place at the
# next login. Where they cannot be had this says so and exits 0: the tests then skip.
set -eu

packages='pulseaudio pulseaudio-utils pipewire pipewire-bin wireplumber pipewire-pulse libasound2-plugins
alsa-utils faketime'

say() { printf 'servers: %s\n' "$*" >&2; }

without() {
    say "none: $*; the tests that need them will skip"
    exit 0
}

missing=
for package in $packages; do
    case $(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true) in
        *' installed') ;;
        *) missing="$missing $package" ;;
    esac
done
[ -n "$missing" ] || exit 0
command -v apt-get >/dev/null 2>&1 || without "they are installed with apt-get, which is not here; missing:$missing"

for socket in /run/user/*/pulse/native /run/user/*/pipewire-0; do
    [ ! -S "$socket" ] || without "a sound server is in use here; missing beside it:$missing"
done

elevate=
if [ "$(id -u)" -ne 0 ]; then
    elevate='sudo -n'
    $elevate true 2>/dev/null || without "run as root: apt-get install --no-install-recommends$missing"
fi

apt_get() {
    # shellcheck disable=SC2086
    $elevate env DEBIAN_FRONTEND=noninteractive NEEDRESTART_SUSPEND=1 \
        apt-get -q -y -o DPkg::Lock::Timeout=120 "$@" >/dev/null 2>&1 </dev/null
}

say "installing:$missing"
# shellcheck disable=SC2086
if ! apt_get install --no-install-recommends --no-remove $missing; then
    apt_get update || true
    apt_get install --no-install-recommends --no-remove $missing ||
        without "apt-get cannot install$missing (no network?)"
fi
