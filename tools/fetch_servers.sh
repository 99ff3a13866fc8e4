#!/bin/sh
# The sound servers that the tests marked `servers` run against: PulseAudio, PipeWire with WirePlumber and
# pipewire-pulse, ALSA's pulse plugin, the small programs that play and record, hosts of the plugin, and promtool.
# Then what a login under systemd needs.
#
# pipewire-alsa stays out: it conflicts with PulseAudio. Where somebody's sound server runs nothing is
# installed, since a second one could take its place at the next login.
set -eu

. "$(dirname "$0")/system_packages.sh"
who=servers

packages='pulseaudio pulseaudio-utils pipewire pipewire-bin wireplumber pipewire-pulse libasound2-plugins
alsa-utils faketime ffmpeg gstreamer1.0-plugins-bad gstreamer1.0-plugins-base gstreamer1.0-tools
ladspa-sdk lilv-utils lv2-dev sordi strace prometheus mpv pipewire-jack'

# shellcheck disable=SC2086
missing=$(missing_packages $packages)
if [ -n "$missing" ]; then
    for socket in /run/user/*/pulse/native /run/user/*/pipewire-0; do
        [ ! -S "$socket" ] || without "a sound server is in use here; missing beside it:$missing"
    done
    # shellcheck disable=SC2086
    install_packages "$who" $packages
fi
install_packages "$who" libpam-systemd dbus-user-session
